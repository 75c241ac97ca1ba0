// Where everything has its position in the texture: nodes, true positions, fixes, landmarks, ellipses.

import { CIRCLE } from "./ellipses.js";
import { Positions } from "./layers.js";

const MOST_ELLIPSES = 300;

/** Return the texture of a model's positions, where its parts begin, and which nodes have ellipses. */
export function place(model) {
  const { arrays, nodeCount: n, dimension: d } = model;
  const count = (name) => (arrays[name]?.length ?? 0) / d;
  const first = { truth: n };
  first.fixes = first.truth + count("truth");
  first.landmarks = first.fixes + count("fixes");
  first.ellipses = first.landmarks + count("landmarks");
  const circles = d === 2 ? 1 : 3, ellipseNodes = [];
  if (arrays.covariances) {
    const step = Math.max(1, Math.ceil(n / MOST_ELLIPSES));
    for (let k = 0; k < n; k += step) ellipseNodes.push(k);
  }
  // One more, of the node that is selected.
  const points = (ellipseNodes.length + 1) * circles * CIRCLE;
  const positions = new Positions(first.ellipses + points);
  for (const name of ["truth", "fixes", "landmarks"]) {
    if (arrays[name]) positions.write(first[name], arrays[name], d);
  }
  positions.write(0, model.positions, d);
  return { positions, first, circles, ellipseNodes };
}
