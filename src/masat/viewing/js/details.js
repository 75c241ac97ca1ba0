// The card of the node, edge or landmark that is picked or pointed at.

import { element, number, rows } from "./format.js";

const KINDS = { odometry: "odometry", closures: "loop closure", rejected: "rejected", off: "switched off" };
// Edges of a node that the card lists.
const MOST_LINKS = 24;
const POSE_NAMES = { 2: ["x", "y", "θ"], 3: ["x", "y", "z", "qx", "qy", "qz", "qw"] };
const STEP_NAMES = { 2: ["x", "y", "θ"], 3: ["x", "y", "z", "qx", "qy", "qz"] };

export class Details {
  /** `actions` has pick(what), fly(what) and toggle(edge). */
  constructor(model, actions) {
    this.model = model;
    this.actions = actions;
    this.card = document.getElementById("details");
  }

  /** Show what is picked, or else what is pointed at, or nothing. */
  show(picked, hovered) {
    const what = picked ?? hovered;
    this.card.hidden = what === null;
    if (what === null) return;
    this.card.toggleAttribute("data-hover", picked === null);
    const write = { edge: this._edge, node: this._node, landmark: this._landmark }[what.kind];
    this.card.replaceChildren(...write.call(this, what.index, picked !== null));
  }

  _edge(k, isPicked) {
    const { model } = this, { arrays, header } = model, d = model.dimension;
    const layer = model.layerOf(k), size = d === 2 ? 3 : 7, dof = d === 2 ? 3 : 6;
    const pairs = [["chi2", number(model.chi2[k])]];
    if (arrays.weights && arrays.kept[k]) pairs.push(["robust weight", number(arrays.weights[k])]);
    pairs.push(["measurement", pose(arrays.measurements.subarray(k * size, (k + 1) * size), POSE_NAMES[d])]);
    if (model.isResult) {
      pairs.push(["residual", pose(arrays.residuals.subarray(k * dof, (k + 1) * dof), STEP_NAMES[d])]);
    }
    if (model.hasDecision) {
      pairs.push(["decision", header.reasons[arrays.reason[k]]]);
      if (!Number.isNaN(arrays.distance[k])) pairs.push(["distance²", number(arrays.distance[k])]);
      if (arrays.cluster[k] >= 0) pairs.push(["cluster", number(arrays.cluster[k])]);
    }
    if (header.labels) pairs.push(["label", header.labels[arrays.label[k]]]);
    pairs.push(["index", `#${k}`]);
    const bad = layer === "rejected" || layer === "off";
    const tag = element("span", { className: bad ? "tag bad" : "tag" }, KINDS[layer]);
    const parts = [element("h3", {}, `Edge ${model.name(k)}  `, tag), table(pairs)];
    parts[0].dataset.chi2 = model.chi2[k];
    if (!isPicked) return parts;
    const [a, b] = model.ends(k);
    parts.push(element(
      "div", { className: "row" },
      this._button("Fly there", () => this.actions.fly({ kind: "edge", index: k })),
      this._button(model.isOff[k] ? "Switch on" : "Switch off", () => this.actions.toggle(k)),
      this._button(`Node ${model.id(a)}`, () => this.actions.pick({ kind: "node", index: a })),
      this._button(`Node ${model.id(b)}`, () => this.actions.pick({ kind: "node", index: b })),
    ));
    return parts;
  }

  _node(k, isPicked) {
    const { model } = this, { arrays, header } = model, d = model.dimension;
    const position = model.point(k).map((value, c) => value + header.center[c]);
    const names = POSE_NAMES[d], pairs = [["position", pose(position, names)]];
    if (model.isResult) {
      const turn = arrays.rotations.subarray(k * (d === 2 ? 1 : 4), (k + 1) * (d === 2 ? 1 : 4));
      pairs.push(["orientation", pose(turn, names.slice(d))]);
    }
    if (arrays.stamps) pairs.push(["time", `${number(arrays.stamps[k], 9)} s after ${header.first_stamp}`]);
    if (arrays.session) pairs.push(["session", `${arrays.session[k]}`]);
    if (arrays.component) pairs.push(["component", `${arrays.component[k]}`]);
    if (arrays.covariances && model.isResult) {
      const size = (d * (d + 1)) / 2, c = arrays.covariances.subarray(k * size, (k + 1) * size);
      const diagonal = d === 2 ? [c[0], c[2]] : [c[0], c[3], c[5]];
      pairs.push(["std. dev.", `${pose(diagonal.map(Math.sqrt), names, 3)} m`]);
    }
    arrays.prior_nodes?.forEach((node, prior) => {
      if (node !== k) return;
      const kept = arrays.prior_kept?.[prior] === 0 ? ", rejected" : "";
      pairs.push(["prior", `chi2 ${number(arrays.prior_chi2[prior])}${kept}`]);
    });
    const edges = model.edgesAt(k);
    pairs.push(["edges", `${edges.length}`]);
    const isFixed = header.fixed.includes(model.id(k));
    const heading = element("h3", {}, `Node ${model.id(k)}  `);
    if (arrays.gauge.includes(k)) heading.append(element("span", { className: "tag" }, isFixed ? "fixed" : "gauge-fixed"));
    const parts = [heading, table(pairs)];
    if (!isPicked) return parts;
    const links = element("div", { className: "links" });
    for (const edge of edges.subarray(0, MOST_LINKS)) {
      links.append(this._button(model.name(edge), () => this.actions.pick({ kind: "edge", index: edge })));
    }
    const fly = this._button("Fly there", () => this.actions.fly({ kind: "node", index: k }));
    return [...parts, links, element("div", { className: "row" }, fly)];
  }

  _landmark(k, isPicked) {
    const { model } = this, { arrays, header } = model, d = model.dimension;
    const position = [...arrays.landmarks.subarray(k * d, (k + 1) * d)].map((v, c) => v + header.center[c]);
    let seen = 0, chi2 = 0;
    for (let row = 0; row < arrays.observation_chi2.length; row++) {
      if (arrays.observations[2 * row + 1] !== k) continue;
      seen++;
      chi2 += arrays.observation_chi2[row];
    }
    const pairs = [
      ["position", pose(position, POSE_NAMES[d])], ["observations", `${seen}`], ["their chi2", number(chi2)],
    ];
    const parts = [element("h3", {}, `Landmark ${arrays.landmark_ids[k]}`), table(pairs)];
    if (!isPicked) return parts;
    const fly = this._button("Fly there", () => this.actions.fly({ kind: "landmark", index: k }));
    return [...parts, element("div", { className: "row" }, fly)];
  }

  _button(text, action) {
    return element("button", { type: "button", onclick: action }, text);
  }
}

function table(pairs) { return element("table", {}, ...rows(pairs)); }

/** Return names and numbers of a pose, or that it is not known. */
function pose(values, names, digits = 5) {
  if (Number.isNaN(values[0])) return "not known: give the graph that was solved";
  return [...values].map((value, k) => `${names[k]} ${number(value, digits)}`).join(", ");
}
