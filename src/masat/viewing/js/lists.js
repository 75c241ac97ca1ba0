// The list of edges: those with the largest chi2, or those that were rejected or switched off.

import { element, number } from "./format.js";

const RANKINGS = {
  map: ["worst of the map", (model, k) => !model.isOff[k]],
  closures: ["worst loop closures", (model, k) => !model.isOff[k] && !model.arrays.is_odometry[k]],
  rejected: ["rejected", (model, k) => !model.arrays.kept[k]],
  off: ["switched off", (model, k) => model.isOff[k] === 1],
};

export class EdgeList {
  /** `actions` has pick(what) and fly(what). */
  constructor(model, actions) {
    this.model = model;
    this.actions = actions;
    this.list = document.getElementById("edges");
    this.select = document.getElementById("ranking");
    for (const [key, [text]] of Object.entries(RANKINGS)) {
      if (key === "rejected" && !model.hasDecision) continue;
      this.select.append(element("option", { value: key }, text));
    }
    this.select.value = model.hasDecision && model.arrays.kept.includes(0) ? "rejected" : "map";
    this.select.addEventListener("change", () => this.update());
    this.update();
  }

  update() {
    const { model } = this, [, has] = RANKINGS[this.select.value];
    this.shown = model.worst((k) => has(model, k));
    const items = this.shown.map((edge) => {
      const button = element(
        "button", { type: "button", onclick: () => this._visit(edge), "data-edge": edge },
        element("span", {}, model.name(edge)), number(model.chi2[edge], 4),
      );
      const decided = this.select.value === "off" || this.select.value === "rejected";
      return element("li", { className: model.isOff[edge] && !decided ? "off" : "" }, button);
    });
    if (items.length === 0) items.push(element("li", {}, "none"));
    this.list.replaceChildren(...items);
    this.mark();
  }

  /** Mark the edge that is picked. */
  mark() {
    const { selected } = this.model;
    for (const button of this.list.querySelectorAll("button")) {
      const isPicked = selected?.kind === "edge" && button.dataset.edge === String(selected.index);
      button.setAttribute("aria-current", isPicked);
      if (isPicked) button.scrollIntoView({ block: "nearest" });
    }
  }

  /** Pick the next edge of the list, or the one before it, and fly to it. */
  step(by) {
    if (this.shown.length === 0) return;
    const { selected } = this.model;
    const at = selected?.kind === "edge" ? this.shown.indexOf(selected.index) : -1;
    const next = at < 0 ? (by > 0 ? 0 : this.shown.length - 1) : (at + by + this.shown.length) % this.shown.length;
    this._visit(this.shown[next]);
  }

  _visit(edge) {
    this.actions.pick({ kind: "edge", index: edge });
    this.actions.fly({ kind: "edge", index: edge });
  }
}
