// What the pointer points at: the nearest node, edge or landmark on the screen.

import { EDGE_LAYERS } from "./stack.js";

// Pixels from the pointer within which something is pointed at.
const REACH = 9;
// What lies at the back of a 3D map must be this many pixels nearer to the pointer than what is in front.
const DEPTH_COST = 4;
// Edges that were decided on or switched off are looked for: they are found before others as near.
const ADVANTAGE = { rejected: 3, off: 2, closures: 0, odometry: 0 };

export class Picker {
  constructor(model, drawing) {
    this.model = model;
    this.drawing = drawing;
    this.screen = new Float32Array(0);
  }

  /** The pixel where a node (or a landmark, behind the nodes) is seen, or null behind the camera. */
  pixelOf(index) {
    const { camera } = this.drawing, e = camera.matrix().elements, p = this._point(index);
    const w = e[3] * p[0] + e[7] * p[1] + e[11] * p[2] + e[15];
    if (w <= 0) return null;
    const x = (e[0] * p[0] + e[4] * p[1] + e[8] * p[2] + e[12]) / w;
    const y = (e[1] * p[0] + e[5] * p[1] + e[9] * p[2] + e[13]) / w;
    return [(x + 1) * 0.5 * camera.width, (1 - y) * 0.5 * camera.height];
  }

  /** What is at a pixel: { kind: "node", "edge" or "landmark", index }, or null. */
  at(x, y) {
    this._project();
    const node = this._nearestNode(x, y), edge = this._nearestEdge(x, y);
    // An edge ends in its nodes: near a node that is drawn the node is meant.
    const isNode = node && (!edge || node.cost <= edge.cost || (this.drawing.nodeSize > 4 && node.distance < 6));
    return isNode ? node.what : edge?.what ?? null;
  }

  _point(index) {
    const { values } = this.drawing.positions;
    return values.subarray(4 * index, 4 * index + 3);
  }

  /** Project all nodes and landmarks, unless the same was seen before. */
  _project() {
    const { camera, positions, first } = this.drawing, matrix = camera.matrix(), e = matrix.elements;
    const key = `${e.join()} ${this.model.state} ${camera.width} ${camera.height}`;
    if (key === this.key) return;
    this.key = key;
    const count = first.ellipses, { values } = positions;
    if (this.screen.length !== 3 * count) this.screen = new Float32Array(3 * count);
    const { screen } = this;
    for (let k = 0; k < count; k++) {
      const x = values[4 * k], y = values[4 * k + 1], z = values[4 * k + 2];
      const w = e[3] * x + e[7] * y + e[11] * z + e[15];
      const visible = w > 0 ? 1 / w : NaN;
      screen[3 * k] = (1 + (e[0] * x + e[4] * y + e[8] * z + e[12]) * visible) * 0.5 * camera.width;
      screen[3 * k + 1] = (1 - (e[1] * x + e[5] * y + e[9] * z + e[13]) * visible) * 0.5 * camera.height;
      screen[3 * k + 2] = (e[2] * x + e[6] * y + e[10] * z + e[14]) * visible;
    }
  }

  _nearestNode(x, y) {
    let best = null;
    const consider = (index, what) => {
      const distance = Math.hypot(this.screen[3 * index] - x, this.screen[3 * index + 1] - y);
      const cost = distance + DEPTH_COST * this._depth(index);
      if (distance < REACH && !(cost >= best?.cost)) best = { cost, distance, what };
    };
    for (let k = 0; k < this.model.nodeCount; k++) consider(k, { kind: "node", index: k });
    if (this.drawing.shows("landmarks")) {
      const { first } = this.drawing, count = this.model.arrays.landmark_ids.length;
      for (let k = 0; k < count; k++) consider(first.landmarks + k, { kind: "landmark", index: k });
    }
    return best;
  }

  _nearestEdge(x, y) {
    const { screen } = this, { ends } = this.model.arrays;
    let best = Infinity, nearest = -1;
    for (const name of EDGE_LAYERS) {
      if (!this.drawing.shows(name)) continue;
      for (const edge of this.drawing.edges[name]) {
        const a = 3 * ends[2 * edge], b = 3 * ends[2 * edge + 1];
        const dx = screen[b] - screen[a], dy = screen[b + 1] - screen[a + 1];
        const px = x - screen[a], py = y - screen[a + 1];
        const square = dx * dx + dy * dy;
        const t = square > 0 ? Math.min(Math.max((px * dx + py * dy) / square, 0), 1) : 0;
        const distance = Math.hypot(px - t * dx, py - t * dy);
        if (!(distance < REACH)) continue;
        const depth = (1 - t) * this._depth(ends[2 * edge]) + t * this._depth(ends[2 * edge + 1]);
        const cost = distance + DEPTH_COST * depth - ADVANTAGE[name];
        if (cost < best) {
          best = cost;
          nearest = edge;
        }
      }
    }
    return nearest < 0 ? null : { cost: best, what: { kind: "edge", index: nearest } };
  }

  _depth(index) { return this.drawing.camera.is3d ? Math.max(this.screen[3 * index + 2], 0) : 0; }
}
