// Layers of lines and of dots, each of which is drawn by one call.

import { DOT_FRAGMENT, DOT_VERTEX, LINE_FRAGMENT, LINE_VERTEX, PLAIN_FRAGMENT, PLAIN_VERTEX } from "./shaders.js";

/** The positions of everything, in meters from the center, in a texture that all layers read. */
export class Positions {
  constructor(count) {
    const columns = Math.max(1, Math.ceil(Math.sqrt(count)));
    const rows = Math.max(1, Math.ceil(count / columns));
    this.values = new Float32Array(4 * columns * rows);
    this.texture = new THREE.DataTexture(
      this.values, columns, rows, THREE.RGBAFormat, THREE.FloatType,
    );
  }

  /** Write points of 2 or 3 coordinates from an index on. */
  write(first, points, dimension) {
    const count = points.length / dimension;
    for (let k = 0; k < count; k++) {
      for (let c = 0; c < dimension; c++) this.values[4 * (first + k) + c] = points[dimension * k + c];
    }
    this.texture.needsUpdate = true;
  }
}

function material(vertexShader, fragmentShader, shared, own, depth) {
  const uniforms = { ...shared };
  for (const [name, value] of Object.entries(own)) uniforms[name] = { value };
  return new THREE.ShaderMaterial({
    vertexShader, fragmentShader, uniforms, transparent: true, depthTest: depth, depthWrite: depth,
  });
}

/** Give an object other attributes: each its values, its size, and whether bytes mean 0 to 1. */
function renew(object, attributes) {
  object.geometry.dispose();
  object.geometry = new THREE.BufferGeometry();
  for (const [name, values] of Object.entries(attributes)) {
    object.geometry.setAttribute(name, new THREE.BufferAttribute(...values));
  }
}

class Layer {
  constructor(object, order) {
    this.object = object;
    object.frustumCulled = false;
    object.renderOrder = order;
    this.uniforms = object.material.uniforms;
  }

  get visible() { return this.object.visible; }
  set visible(shown) { this.object.visible = shown; }
  get objects() { return [this.object]; }
}

// Layers with more lines have coarser forms, which are drawn while the map moves where needed. Level 0
// are lines with a width, level 1 plain ones, and further levels have a line for so many of them.
const MANY_LINES = 2000;
const STRIDES = [1, 2, 4, 8];
export const COARSEST = STRIDES.length;
// Two triangles of the four corners of a line.
const CORNERS = [0, 1, 2, 2, 1, 3];

/** Lines between pairs of positions. */
export class Lines extends Layer {
  constructor(shared, { width, order, opacity = 1, dash = [0, 0], depth = false, isChain = false }) {
    const own = { width, opacity, dash: new THREE.Vector2(...dash) };
    super(new THREE.Mesh(new THREE.BufferGeometry(), material(LINE_VERTEX, LINE_FRAGMENT, shared, own, depth)), order);
    this.object.material.side = THREE.DoubleSide;
    this.plain = new THREE.LineSegments(
      new THREE.BufferGeometry(), material(PLAIN_VERTEX, PLAIN_FRAGMENT, this.uniforms, {}, depth),
    );
    this.plain.frustumCulled = false;
    this.plain.renderOrder = order;
    this.plain.visible = false;
    this.isChain = isChain;
    this.coarseness = 0;
  }

  get objects() { return [this.object, this.plain]; }
  get visible() { return this.isShown ?? true; }
  set visible(shown) {
    this.isShown = shown;
    this._choose();
  }

  /** How coarsely the lines are drawn, from 0 to COARSEST. */
  set level(level) {
    this.coarseness = level;
    this._choose();
  }

  _choose() {
    const range = this.ranges?.[this.coarseness - 1];
    this.object.visible = this.visible && !range;
    this.plain.visible = this.visible && Boolean(range);
    if (range) this.plain.geometry.setDrawRange(...range);
  }

  /** Draw lines between `pairs` of indices of positions, each with a color of four bytes. */
  set(pairs, tints) {
    // Four corners a line. Instances would need less memory, but software draws them one by one.
    const count = pairs.length / 2;
    const ends = new Float32Array(8 * count), colors = new Uint32Array(4 * count);
    const corners = new Uint32Array(6 * count), ofLine = new Uint32Array(tints.buffer);
    for (let k = 0; k < count; k++) {
      for (let c = 0; c < 4; c++) {
        ends[8 * k + 2 * c] = pairs[2 * k];
        ends[8 * k + 2 * c + 1] = pairs[2 * k + 1];
      }
      colors.fill(ofLine[k], 4 * k, 4 * k + 4);
      for (let c = 0; c < 6; c++) corners[6 * k + c] = 4 * k + CORNERS[c];
    }
    renew(this.object, { ends: [ends, 2, false], tint: [new Uint8Array(colors.buffer), 4, true] });
    this.object.geometry.setIndex(new THREE.BufferAttribute(corners, 1));
    this.ranges = count > MANY_LINES ? this._setPlain(pairs, ofLine) : null;
    this._choose();
  }

  /** Set plain lines of all levels, one after another; return where each level begins and its size. */
  _setPlain(pairs, colors) {
    const levels = STRIDES.map((stride) => coarser(pairs, stride, this.isChain));
    const total = levels.reduce((sum, { ends }) => sum + ends.length, 0);
    const node = new Float32Array(total), tint = new Uint32Array(total), ranges = [];
    let at = 0;
    for (const { ends, lines } of levels) {
      node.set(ends, at);
      lines.forEach((line, k) => tint.fill(colors[line], at + 2 * k, at + 2 * k + 2));
      ranges.push([at, ends.length]);
      at += ends.length;
    }
    renew(this.plain, { node: [node, 1, false], tint: [new Uint8Array(tint.buffer), 4, true] });
    return ranges;
  }
}

/**
 * Return pairs of ends of fewer lines, and which line each has its color from. Lines of a chain that follow
 * each other are joined, of others only some are kept.
 */
function coarser(pairs, stride, isChain) {
  const count = pairs.length / 2, ends = [], lines = [];
  for (let k = 0; k < count;) {
    let last = k;
    if (isChain) while (last < k + stride - 1 && pairs[2 * last + 1] === pairs[2 * last + 2]) last++;
    ends.push(pairs[2 * k], pairs[2 * last + 1]);
    lines.push(k);
    k = isChain ? last + 1 : k + stride;
  }
  return { ends, lines };
}

/** Dots at positions. */
export class Dots extends Layer {
  constructor(shared, { size, order, shape = 0, depth = false }) {
    const own = { size, opacity: 1, shape };
    const geometry = new THREE.BufferGeometry();
    super(new THREE.Points(geometry, material(DOT_VERTEX, DOT_FRAGMENT, shared, own, depth)), order);
  }

  /** Draw dots at indices of positions, each with a color of four bytes. */
  set(nodes, tints) {
    renew(this.object, { node: [nodes, 1, false], tint: [tints, 4, true] });
    this.object.geometry.setDrawRange(0, nodes.length);
  }
}
