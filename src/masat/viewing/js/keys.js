// The keyboard, and the help that lists its keys.

import { VIEWS } from "./camera.js";
import { element } from "./format.js";

const HELP = [
  ["?", "this help"],
  ["f", "see the whole map"],
  ["v", "the next view of a 3D map: oblique, top, front, side"],
  ["+ −", "nearer, farther"],
  ["/", "find a node or an edge"],
  ["n  N", "fly to the next edge of the list, or the one before"],
  ["Enter", "fly to what is picked"],
  ["x", "switch the picked edge off, or on again"],
  ["e", "export the list of the edges that are off"],
  ["← →", "the map before, the map after"],
  ["b", "before and after: the first map and the result"],
  ["space", "go through all maps"],
  ["c", "the next color"],
  ["1 … 9", "show or hide a layer"],
  ["p", "show or hide the panel"],
  ["t", "light or dark"],
  ["Esc", "pick nothing"],
];

export class Keys {
  /** `actions` has a function for each key below. */
  constructor(camera, actions) {
    this.camera = camera;
    this.actions = actions;
    this.help = document.getElementById("help");
    this._writeHelp();
    document.getElementById("help-button").addEventListener("click", () => this._toggleHelp());
    addEventListener("keydown", (event) => this._press(event));
  }

  _press(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const typing = event.target.matches?.("input[type=search], select");
    if (typing) {
      if (event.key === "Escape") event.target.blur();
      return;
    }
    // Buttons and sliders keep their own keys.
    const own = event.target.matches?.("button, input") && [" ", "Enter", "ArrowLeft", "ArrowRight"].includes(event.key);
    if (own || (this.help.open && event.key !== "?")) return;
    const { actions } = this, bound = {
      "?": () => this._toggleHelp(), f: actions.fit, v: () => this._nextView(), "/": actions.search,
      n: () => actions.step(1), N: () => actions.step(-1), Enter: actions.flyToPicked, x: actions.toggle,
      e: actions.export, ArrowLeft: () => actions.show(-1), ArrowRight: () => actions.show(1), b: actions.compare,
      " ": actions.play, c: actions.color, p: actions.panel, t: actions.theme, Escape: actions.clear,
      "+": () => actions.zoom(1.25), "=": () => actions.zoom(1.25), "-": () => actions.zoom(0.8),
    }[event.key] ?? (/^[1-9]$/.test(event.key) ? () => actions.layer(Number(event.key) - 1) : null);
    if (!bound) return;
    event.preventDefault();
    bound();
  }

  _nextView() {
    if (!this.camera.is3d) return;
    const names = Object.keys(VIEWS);
    this.view = ((this.view ?? 0) + 1) % names.length;
    this.camera.look(VIEWS[names[this.view]]);
  }

  _toggleHelp() {
    if (this.help.open) this.help.close();
    else this.help.showModal();
  }

  _writeHelp() {
    const mouse = this.camera.is3d
      ? "Drag to rotate, with the right button or Shift to pan, turn the wheel to zoom."
      : "Drag to pan, with the right button or Shift to rotate, turn the wheel to zoom.";
    const table = element("table", {}, ...HELP.map(([keys, text]) => {
      const names = keys.split(/\s+/).flatMap((key) => [element("kbd", {}, key), " "]);
      return element("tr", {}, element("th", {}, ...names), element("td", {}, text));
    }));
    const close = element("button", { type: "button", onclick: () => this.help.close() }, "Close");
    this.help.replaceChildren(
      element("h3", {}, "Help"),
      element("p", {}, `${mouse} Point at nodes and edges to read about them, click to pick them.`),
      table,
      element("p", {}, close),
    );
  }
}
