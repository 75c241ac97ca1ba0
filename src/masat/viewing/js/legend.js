// The legend at the bottom: what the colors mean, and a bar of a round length.

import { THEMES } from "./colors.js";
import { element, number } from "./format.js";

const LONGEST_BAR = 160;
const NAMES = { odometry: "odometry", closures: "loop closures", rejected: "rejected", off: "switched off", truth: "truth" };

export class Legend {
  constructor(drawing) {
    this.drawing = drawing;
    this.box = document.getElementById("legend");
    this.bar = element("div", { id: "bar" });
    this.length = element("span");
  }

  /** Write the legend of the colors. */
  update() {
    const { legend, theme } = this.drawing, colors = THEMES[theme], parts = [];
    if (legend.kind === "scale") {
      parts.push(element("div", {}, legend.name), gradient(legend.table));
      const ticks = legend.ticks.map((tick) => element("span", {}, typeof tick === "number" ? number(tick, 3) : tick));
      parts.push(element("div", { className: "ticks" }, ...ticks));
    }
    const entries = legend.kind === "categories" ? legend.entries.slice() : [];
    const painted = legend.kind === "kinds" ? [] : ["odometry", "closures"];
    for (const name of Object.keys(NAMES)) {
      const has = name === "truth" ? this.drawing.layers.truth : this.drawing.edges[name].length;
      if (has && !painted.includes(name)) entries.push([colors[name], NAMES[name]]);
    }
    const swatches = entries.map(([color, text]) => {
      const square = element("i");
      square.style.background = color;
      return element("span", {}, square, text);
    });
    parts.push(element("div", { className: "swatches" }, ...swatches));
    this.box.replaceChildren(...parts, this.bar, this.length);
    this.measure();
  }

  /** Make the bar as long as a round number of meters. */
  measure() {
    const scale = this.drawing.camera.pixelsPerMeter;
    const most = LONGEST_BAR / scale, power = 10 ** Math.floor(Math.log10(most));
    const meters = power * [5, 2, 1].find((factor) => factor * power <= most);
    if (meters === this.meters && scale === this.scale) return;
    this.meters = meters;
    this.scale = scale;
    this.bar.style.width = `${meters * scale}px`;
    this.length.textContent = meters >= 1000 ? `${number(meters / 1000)} km` : `${number(meters)} m`;
  }
}

function gradient(table) {
  const canvas = element("canvas", { width: 256, height: 1 });
  canvas.style.cssText = "width: 200px; height: 10px";
  const context = canvas.getContext("2d"), image = context.createImageData(256, 1);
  for (let k = 0; k < 256; k++) image.data.set([table[3 * k], table[3 * k + 1], table[3 * k + 2], 255], 4 * k);
  context.putImageData(image, 0, 0);
  return canvas;
}
