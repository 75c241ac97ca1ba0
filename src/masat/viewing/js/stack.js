// All layers of a map, in the order in which they are drawn, and the groups that the panel shows or hides.

import { Dots, Lines } from "./layers.js";

// Layers of edges, by the order in which they are drawn.
export const EDGE_LAYERS = ["closures", "odometry", "off", "rejected"];
export const WIDTHS = { closures: 1.2, odometry: 1.8, off: 1.8, rejected: 2.2 };
const DASHES = { off: [2, 4], rejected: [9, 4] };
// What belongs to the result alone, and is hidden with other maps.
export const OF_RESULT = new Set(["priors", "landmarks", "truth", "ellipses"]);

/** Return the layers by name, and the layers of each group. `shared` are uniforms that all of them read. */
export function makeLayers(shared, arrays, depth) {
  const lines = (order, options) => new Lines(shared, { order, depth, ...options });
  const dots = (order, options) => new Dots(shared, { order, depth, ...options });
  const layers = {};
  if (arrays.truth) layers.truth = lines(1, { width: 1.4, dash: [5, 3] });
  if (arrays.observations) layers.observations = lines(2, { width: 1 });
  EDGE_LAYERS.forEach((name, k) => {
    layers[name] = lines(3 + k, {
      width: WIDTHS[name], dash: DASHES[name], isChain: name === "odometry", depth: depth && name !== "rejected",
    });
  });
  layers.nodes = dots(10, { size: 6 });
  if (arrays.fixes) {
    layers.priorLines = lines(8, { width: 1 });
    layers.fixes = dots(11, { size: 9, shape: 3 });
  }
  if (arrays.landmarks) layers.landmarks = dots(12, { size: 8, shape: 2 });
  if (arrays.covariances) layers.ellipses = lines(13, { width: 1, opacity: 0.6 });
  layers.gauge = dots(14, { size: 13, shape: 1, depth: false });
  layers.hoveredLines = lines(20, { width: 4, depth: false });
  layers.hoveredDots = dots(21, { size: 14, shape: 1, depth: false });
  layers.selectedLines = lines(22, { width: 4, depth: false });
  layers.selectedDots = dots(23, { size: 16, shape: 1, depth: false });
  layers.selectedEllipse = lines(24, { width: 2, depth: false });
  const groups = {
    odometry: [layers.odometry], closures: [layers.closures], rejected: [layers.rejected], off: [layers.off],
    nodes: [layers.nodes], gauge: [layers.gauge],
  };
  if (layers.fixes) groups.priors = [layers.priorLines, layers.fixes];
  if (layers.landmarks) groups.landmarks = [layers.landmarks, layers.observations];
  if (layers.truth) groups.truth = [layers.truth];
  if (layers.ellipses) groups.ellipses = [layers.ellipses];
  return { layers, groups };
}
