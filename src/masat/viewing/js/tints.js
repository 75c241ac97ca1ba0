// Colors of items as bytes: red, green, blue and opacity.

import { rgb } from "./colors.js";

/** Return what gives one color to everything. */
export function constant(color) {
  const value = rgb(color);
  return () => value;
}

/** Return the bytes of all items. */
export function tints(items, colorOf) {
  const out = new Uint8Array(4 * items.length);
  for (let k = 0; k < items.length; k++) {
    const [r, g, b] = colorOf(items[k]);
    out[4 * k] = r;
    out[4 * k + 1] = g;
    out[4 * k + 2] = b;
    out[4 * k + 3] = 255;
  }
  return out;
}

/** Draw lines of one color. */
export function setLines(layer, pairs, color) {
  layer.set(Float32Array.from(pairs), tints({ length: pairs.length / 2 }, constant(color)));
}
