// Layers of lines and of dots, each of which is drawn by one call.

import { DOT_FRAGMENT, DOT_VERTEX, LINE_FRAGMENT, LINE_VERTEX } from "./shaders.js";

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

class Layer {
  constructor(object, order) {
    this.object = object;
    object.frustumCulled = false;
    object.renderOrder = order;
    this.uniforms = object.material.uniforms;
  }

  get visible() { return this.object.visible; }
  set visible(shown) { this.object.visible = shown; }

  _attribute(name, values, size, instanced, normalized = false) {
    const kind = instanced ? THREE.InstancedBufferAttribute : THREE.BufferAttribute;
    this.object.geometry.setAttribute(name, new kind(values, size, normalized));
  }
}

/** Lines between pairs of positions. */
export class Lines extends Layer {
  constructor(shared, { width, order, dash = [0, 0], depth = false }) {
    const own = { width, opacity: 1, dash: new THREE.Vector2(...dash) };
    const geometry = new THREE.InstancedBufferGeometry();
    const corners = new Float32Array([0, -1, 0, 1, -1, 0, 0, 1, 0, 1, 1, 0]);
    geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
    geometry.setIndex([0, 1, 2, 2, 1, 3]);
    geometry.instanceCount = 0;
    super(new THREE.Mesh(geometry, material(LINE_VERTEX, LINE_FRAGMENT, shared, own, depth)), order);
    this.object.material.side = THREE.DoubleSide;
  }

  /** Draw lines between `pairs` of indices of positions, each with a color of four bytes. */
  set(pairs, tints) {
    // A new geometry: the buffers of the old one may be too small.
    const old = this.object.geometry;
    const geometry = new THREE.InstancedBufferGeometry();
    geometry.setAttribute("position", old.getAttribute("position"));
    geometry.setIndex(old.getIndex());
    geometry.instanceCount = pairs.length / 2;
    this.object.geometry = geometry;
    this._attribute("ends", pairs, 2, true);
    this._attribute("tint", tints, 4, true, true);
    old.deleteAttribute("position");
    old.setIndex(null);
    old.dispose();
  }

  /** Change the colors alone. */
  paint(tints) {
    const attribute = this.object.geometry.getAttribute("tint");
    attribute.array.set(tints);
    attribute.needsUpdate = true;
  }
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
    this.object.geometry.dispose();
    this.object.geometry = new THREE.BufferGeometry();
    this._attribute("node", nodes, 1, false);
    this._attribute("tint", tints, 4, false, true);
    this.object.geometry.setDrawRange(0, nodes.length);
  }

  /** Change the colors alone. */
  paint(tints) {
    const attribute = this.object.geometry.getAttribute("tint");
    attribute.array.set(tints);
    attribute.needsUpdate = true;
  }
}
