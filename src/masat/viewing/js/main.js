// The page: its data, its parts, and what they do to each other.

import { Camera } from "./camera.js";
import { Details } from "./details.js";
import { Drawing, rendererOf } from "./drawing.js";
import { exportOff, offList, showOff } from "./edits.js";
import { say } from "./format.js";
import { Keys } from "./keys.js";
import { Legend } from "./legend.js";
import { EdgeList } from "./lists.js";
import { Model } from "./model.js";
import { Panel } from "./panel.js";
import { unpack } from "./payload.js";
import { Picker } from "./picking.js";
import { find } from "./search.js";

// A flight ends where this many steps of the odometry fit around its goal, or this part of the map.
const STEPS_AROUND = 5, PART_AROUND = 0.2;
// Pixels that the pointer may move in a click.
const CLICK = 4;

function halvesOf(model) {
  const halves = [], d = model.dimension, positions = model.positions;
  for (let c = 0; c < d; c++) {
    let largest = 1e-3;
    for (let k = c; k < positions.length; k += d) largest = Math.max(largest, Math.abs(positions[k]));
    halves.push(largest);
  }
  return halves;
}

async function begin() {
  const source = document.getElementById("payload");
  // The data is unpacked beside the start of WebGL, which takes as long.
  const unpacking = unpack(source.textContent);
  source.remove();
  const canvas = document.getElementById("map");
  const renderer = rendererOf(canvas);
  const model = new Model(await unpacking);
  let drawing = null;
  const camera = new Camera(canvas, halvesOf(model), () => drawing?.move());
  drawing = new Drawing(renderer, model, camera);
  const picker = new Picker(model, drawing);

  const pointOf = (what) => {
    if (what.kind === "edge") {
      const [a, b] = model.ends(what.index).map((node) => [...model.point(node), 0]);
      return { point: [0, 1, 2].map((c) => (a[c] + b[c]) / 2), size: Math.hypot(...[0, 1, 2].map((c) => a[c] - b[c])) / 2 };
    }
    const d = model.dimension;
    const point = what.kind === "node"
      ? model.point(what.index)
      : [...model.arrays.landmarks.subarray(what.index * d, (what.index + 1) * d)];
    return { point: [...point, 0].slice(0, 3), size: 0 };
  };
  const pick = (what) => model.select(what);
  const fly = (what) => {
    const { point, size } = pointOf(what);
    camera.fly(point, Math.max(size, Math.min(STEPS_AROUND * drawing.spacing, PART_AROUND * camera.radius)));
  };
  const details = new Details(model, { pick, fly, toggle: (edge) => model.toggle(edge) });
  const list = new EdgeList(model, { pick, fly });
  const legend = new Legend(drawing);
  const panel = new Panel(model, drawing);
  const showDetails = () => details.show(model.selected, drawing.hovered);

  const setTheme = (theme) => {
    document.documentElement.dataset.theme = theme;
    drawing.setTheme(theme);
    legend.update();
    panel.writeLayers();
  };
  const toggleTheme = () => setTheme(drawing.theme === "light" ? "dark" : "light");

  model.on("state", () => {
    drawing.moveNodes();
    if (model.coloring === "chi2") drawing.paint();
    panel.writeState();
    list.update();
    legend.update();
    showDetails();
  });
  model.on("selection", () => {
    drawing.highlight();
    list.mark();
    showDetails();
  });
  model.on("coloring", () => {
    drawing.paint();
    legend.update();
  });
  model.on("off", () => {
    drawing.assign();
    panel.writeLayers();
    list.update();
    legend.update();
    showOff(model);
    showDetails();
  });
  drawing.afterFrame.push(() => legend.measure());
  showOff(model);
  document.getElementById("export").addEventListener("click", () => exportOff(model));
  document.getElementById("restore").addEventListener("click", () => model.restore());
  document.getElementById("theme-button").addEventListener("click", toggleTheme);

  const query = document.getElementById("query");
  document.getElementById("search").addEventListener("submit", (event) => {
    event.preventDefault();
    const found = find(model, query.value);
    if (typeof found === "string") {
      say(found);
      return;
    }
    pick(found);
    fly(found);
  });

  new Keys(camera, {
    fit: () => camera.look(undefined), search: () => query.focus(), step: (by) => list.step(by),
    flyToPicked: () => model.selected && fly(model.selected),
    toggle: () => (model.selected?.kind === "edge" ? model.toggle(model.selected.index) : say("Pick an edge first.")),
    export: () => exportOff(model), show: (by) => model.show(model.state + by),
    compare: () => model.show(model.isResult ? 0 : model.stateCount - 1), play: () => panel.play(),
    color: () => panel.nextColoring(), panel: () => panel.toggle(), theme: toggleTheme,
    clear: () => pick(null), zoom: (factor) => camera.zoomBy(factor),
    layer: (k) => panel.layerNames[k] && panel.toggleLayer(panel.layerNames[k]),
  });
  listenToPointer(canvas, picker, drawing, { pick, showDetails, isFree: () => model.selected === null });
  addEventListener("resize", () => {
    panel.cover();
    drawing.resize();
  });

  setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  panel.cover();
  drawing.resize();
  camera.look(undefined);
  camera.advance(performance.now());
  drawing.draw();
  // For tests and for the console.
  globalThis.masat = {
    model, drawing, camera, picker, setTheme, pick, fly, find: (text) => find(model, text),
    offList: () => offList(model), firstFrame: performance.now(),
  };
}

/** Read about what is pointed at, and pick what is clicked. */
function listenToPointer(canvas, picker, drawing, { pick, showDetails }) {
  let down = null, latest = null;
  canvas.addEventListener("pointerdown", (event) => { down = [event.clientX, event.clientY]; });
  canvas.addEventListener("pointerup", (event) => {
    if (!down || event.button !== 0) return;
    const moved = Math.hypot(event.clientX - down[0], event.clientY - down[1]);
    down = null;
    if (moved <= CLICK) pick(picker.at(event.clientX, event.clientY));
  });
  const hover = (what) => {
    const same = what?.kind === drawing.hovered?.kind && what?.index === drawing.hovered?.index;
    if (same) return;
    drawing.hovered = what;
    canvas.style.cursor = what ? "pointer" : "";
    drawing.highlight();
    showDetails();
  };
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons || event.pointerType === "touch") return;
    const isAsked = latest !== null;
    latest = [event.clientX, event.clientY];
    if (!isAsked) {
      requestAnimationFrame(() => {
        hover(picker.at(...latest));
        latest = null;
      });
    }
  });
  canvas.addEventListener("pointerleave", () => hover(null));
}

begin().catch((error) => {
  console.error(error);
  say("");
  const message = document.getElementById("message");
  clearTimeout(say.timer);
  const why = error.message.replace(/\.$/, "");
  message.textContent = `The map cannot be drawn: ${why}. The page needs a browser of 2023 or later with WebGL 2.`;
  message.hidden = false;
});
