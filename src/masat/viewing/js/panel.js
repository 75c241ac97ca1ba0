// The panel on the right: facts, the slider, colors and layers.

import { VIEWS } from "./camera.js";
import { colorings } from "./colorings.js";
import { THEMES } from "./colors.js";
import { count, element, number, rows } from "./format.js";
import { OF_RESULT } from "./stack.js";

const LAYER_NAMES = {
  odometry: "odometry", closures: "loop closures", rejected: "rejected", off: "switched off", nodes: "nodes",
  gauge: "not optimized", priors: "priors", landmarks: "landmarks", truth: "truth", ellipses: "95 % ellipses",
};
const PLAY_MS = 700;

export class Panel {
  constructor(model, drawing) {
    this.model = model;
    this.drawing = drawing;
    this.wanted = Object.fromEntries(Object.keys(drawing.groups).map((name) => [name, true]));
    if (model.arrays.truth) this.wanted.truth = true;
    this.box = document.getElementById("panel");
    this.unfold = document.getElementById("unfold");
    this._writeFacts();
    this._makeSlider();
    this._makeColoring();
    this._makeViews();
    document.getElementById("fold").addEventListener("click", () => this.toggle());
    this.unfold.addEventListener("click", () => this.toggle());
    this.cover();
    this.writeLayers();
  }

  /** Hide or show the panel. */
  toggle() {
    this.box.hidden = !this.box.hidden;
    this.unfold.hidden = !this.box.hidden;
    this.cover();
  }

  /** Tell the camera how much of the window the panel covers. */
  cover() {
    const isBeside = !this.box.hidden && innerWidth > 640;
    this.drawing.camera.covered = isBeside ? this.box.offsetWidth + 20 : 0;
    this.drawing.camera.resize();
  }

  toggleLayer(name) {
    this.wanted[name] = !this.wanted[name];
    this.writeLayers();
  }

  /** Names of the layers that there are, in the order of the panel. */
  get layerNames() {
    return Object.keys(LAYER_NAMES).filter((name) => this.drawing.groups[name] && this._count(name) > 0);
  }

  writeLayers() {
    const items = this.layerNames.map((name, k) => {
      const box = element("input", { type: "checkbox", checked: this.wanted[name], "data-layer": name });
      box.addEventListener("change", () => this.toggleLayer(name));
      const away = !this.model.isResult && OF_RESULT.has(name) ? " (result only)" : "";
      return element(
        "label", { title: k < 9 ? `Key ${k + 1}` : "" }, box, swatch(name, THEMES[this.drawing.theme]),
        element("span", {}, LAYER_NAMES[name] + away), element("small", {}, count(this._count(name))),
      );
    });
    document.getElementById("layers").replaceChildren(...items);
    this.drawing.updateVisibility(this.wanted);
  }

  writeState() {
    const { model } = this, { header } = model;
    document.getElementById("state").value = model.state;
    const chi2 = header.chi2[model.state];
    document.getElementById("state-text").textContent =
      `${header.states[model.state]}: chi2 of the edges ${number(chi2)}`;
    this.writeLayers();
  }

  /** Go through all maps, from the first one if the result is shown. */
  play() {
    const button = document.getElementById("play");
    if (this.timer) {
      clearInterval(this.timer);
      this.timer = null;
    } else if (this.model.stateCount > 1) {
      if (this.model.isResult) this.model.show(0);
      this.timer = setInterval(() => {
        this.model.show(this.model.state + 1);
        if (this.model.isResult) this.play();
      }, PLAY_MS);
    }
    button.textContent = this.timer ? "❚❚" : "▶";
  }

  nextColoring() {
    const select = document.getElementById("coloring");
    select.selectedIndex = (select.selectedIndex + 1) % select.length;
    this.model.color(select.value);
  }

  _count(name) {
    const { arrays } = this.model;
    const counts = {
      nodes: () => this.model.nodeCount, gauge: () => arrays.gauge.length, priors: () => arrays.prior_nodes.length,
      landmarks: () => arrays.landmark_ids.length, truth: () => this.model.nodeCount,
      ellipses: () => this.drawing.ellipseNodes.length,
    };
    return counts[name]?.() ?? this.drawing.edges[name].length;
  }

  _writeFacts() {
    const { header, edgeCount, stateCount } = this.model;
    document.getElementById("title").textContent = header.title;
    const facts = [...header.facts];
    facts[0] = [facts[0][0], `${facts[0][1]}, ${count(edgeCount)} edges`];
    facts.splice(1, 0, ["chi2 of edges", number(header.chi2[stateCount - 1])]);
    if (header.truth_rmse !== undefined) facts.push(["from truth", `${number(header.truth_rmse, 4)} m RMSE`]);
    document.getElementById("facts").replaceChildren(...rows(facts));
    document.getElementById("notes").textContent = header.notes.join(" · ");
  }

  _makeSlider() {
    const { model } = this;
    if (model.stateCount < 2) return;
    document.getElementById("states").hidden = false;
    const slider = document.getElementById("state");
    slider.max = model.stateCount - 1;
    slider.addEventListener("input", () => model.show(Number(slider.value)));
    document.getElementById("play").addEventListener("click", () => this.play());
    this.writeState();
  }

  _makeColoring() {
    const select = document.getElementById("coloring");
    for (const [key, text] of colorings(this.model)) select.append(element("option", { value: key }, text));
    select.addEventListener("change", () => this.model.color(select.value));
  }

  _makeViews() {
    if (!this.drawing.camera.is3d) return;
    const box = document.getElementById("views");
    box.hidden = false;
    box.style.marginTop = "6px";
    for (const name of Object.keys(VIEWS)) {
      box.append(element("button", { type: "button", onclick: () => this.drawing.camera.look(VIEWS[name]) }, name));
    }
  }
}

function swatch(name, colors) {
  const namespace = "http://www.w3.org/2000/svg";
  const picture = document.createElementNS(namespace, "svg");
  for (const [key, value] of [["width", 18], ["height", 10], ["viewBox", "0 0 18 10"]]) picture.setAttribute(key, value);
  const isDot = ["nodes", "gauge", "landmarks"].includes(name);
  const shape = document.createElementNS(namespace, isDot ? "circle" : "line");
  const place = isDot ? { cx: 9, cy: 5, r: 4 } : { x1: 0, y1: 5, x2: 18, y2: 5 };
  for (const [key, value] of Object.entries(place)) shape.setAttribute(key, value);
  const color = colors[name];
  const hollow = name === "gauge";
  shape.setAttribute("stroke", isDot && !hollow ? "none" : color);
  shape.setAttribute("fill", isDot && !hollow ? color : "none");
  shape.setAttribute("stroke-width", isDot ? 2 : 3);
  const dash = { rejected: "6 3", off: "2 3", truth: "4 2" }[name];
  if (dash) shape.setAttribute("stroke-dasharray", dash);
  picture.append(shape);
  return picture;
}
