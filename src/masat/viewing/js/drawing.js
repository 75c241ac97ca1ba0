// The layers of the map, kept up to date with the model, and when they are drawn.

import { painter } from "./colorings.js";
import { THEMES, rgb } from "./colors.js";
import { CIRCLE, circlePairs, ellipsePoints } from "./ellipses.js";
import { COARSEST, Dots, Lines } from "./layers.js";
import { Pace } from "./pace.js";
import { place } from "./placement.js";
import { EDGE_LAYERS, OF_RESULT, WIDTHS, makeLayers } from "./stack.js";
import { constant, setLines, tints } from "./tints.js";

// Which part of the map lines may cover before they become transparent, and how faint they may become.
const INK = { closures: [0.25, 0.12], odometry: [0.6, 0.35], off: [0.5, 0.3], rejected: [0.45, 0.4] };
// Dots of nodes take this part of the distance between them; smaller ones are not drawn.
const NODE_PART = 0.3, SMALLEST_NODE = 2.5, LARGEST_NODE = 9;
// More nodes are left out while a map moves that cannot keep up.
const MANY_NODES = 2000;
// A map that has not moved for so long is drawn with all details.
const REST_MS = 300;

/** Return what draws on a canvas. */
export function rendererOf(canvas) {
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: false, alpha: false });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  return renderer;
}

export class Drawing {
  constructor(renderer, model, camera) {
    this.renderer = renderer;
    this.model = model;
    this.camera = camera;
    this.theme = "light";
    this.scene = new THREE.Scene();
    this.frames = 0;
    this.pace = new Pace(COARSEST);
    this.level = 0;
    this.afterFrame = [];
    this.hovered = null;
    Object.assign(this, place(model));
    this._shared = {
      positions: { value: this.positions.texture },
      resolution: { value: new THREE.Vector2(1, 1) },
      near: { value: 0 },
      fade: { value: new THREE.Vector2(0, 0) },
      paper: { value: new THREE.Vector3(1, 1, 1) },
    };
    Object.assign(this, makeLayers(this._shared, model.arrays, camera.is3d));
    for (const layer of Object.values(this.layers)) this.scene.add(...layer.objects);
    this.edges = {};
    this.lengths = {};
    this._assignLayers();
    this._measure();
  }

  /** Ask for a picture with the next frame. */
  request() {
    if (this.requested) return;
    this.requested = true;
    const asked = performance.now();
    requestAnimationFrame((now) => {
      this.requested = false;
      // Frames come late where those before are still being drawn.
      if (this.isMoving) this.pace.count(performance.now() - asked);
      const flies = this.camera.advance(now);
      this.draw();
      if (flies) this.move();
    });
  }

  /** Draw as coarsely as this machine needs to keep up, until the map has stood still for a moment. */
  move() {
    this.isMoving = true;
    this._setLevel(this.pace.level);
    this._restLater();
    this.request();
  }

  _restLater() {
    clearTimeout(this.resting);
    this.resting = setTimeout(() => {
      // A frame that is still to come is part of the movement.
      if (this.requested) {
        this._restLater();
        return;
      }
      this.isMoving = false;
      this._setLevel(0);
      this.request();
    }, REST_MS);
  }

  _setLevel(level) {
    if (level === this.level) return;
    this.level = level;
    for (const layer of Object.values(this.layers)) if (layer instanceof Lines) layer.level = level;
  }

  draw() {
    const { camera, _shared: shared } = this;
    this._scaleLines();
    if (camera.is3d) {
      const distance = camera.camera.position.length();
      shared.near.value = camera.camera.near;
      shared.fade.value.set(distance - 0.6 * camera.radius, 0.42 / camera.radius);
    }
    this.renderer.render(this.scene, camera.camera);
    this.frames++;
    for (const listener of this.afterFrame) listener();
  }

  resize() {
    const { width, height } = this.camera;
    this.renderer.setSize(width, height, false);
    // Widths are in pixels of the page, on any screen.
    this._shared.resolution.value.set(width, height);
    this.request();
  }

  setTheme(theme) {
    this.theme = theme;
    const paper = rgb(THEMES[theme].paper);
    this._shared.paper.value.set(...paper.map((value) => value / 255));
    this.renderer.setClearColor(new THREE.Color(THEMES[theme].paper), 1);
    this.paint();
  }

  /** Give each edge to its layer again. */
  assign() {
    this._assignLayers();
    this._measure();
    this.paint();
  }

  _assignLayers() {
    const lists = Object.fromEntries(EDGE_LAYERS.map((name) => [name, []]));
    for (let k = 0; k < this.model.edgeCount; k++) lists[this.model.layerOf(k)].push(k);
    for (const name of EDGE_LAYERS) this.edges[name] = lists[name];
  }

  /** Color everything. */
  paint() {
    const colors = THEMES[this.theme], paints = painter(this.model, this.theme);
    this.legend = paints.legend;
    for (const name of EDGE_LAYERS) {
      const edges = this.edges[name];
      // What is off keeps its color, so that it is not taken for a part of the map.
      const own = paints.edge && (name === "odometry" || name === "closures");
      // Odometry stays in its order, so that its lines can be joined.
      if (own && paints.order && name === "closures") paints.order(edges);
      else edges.sort((a, b) => a - b);
      const pairs = new Float32Array(2 * edges.length);
      edges.forEach((edge, k) => pairs.set(this.model.ends(edge), 2 * k));
      this.layers[name].set(pairs, tints(edges, own ? paints.edge : constant(colors[name])));
    }
    const all = Float32Array.from({ length: this.model.nodeCount }, (_, k) => k);
    this.layers.nodes.set(all, tints(all, paints.node ?? constant(colors.nodes)));
    this._paintOthers(colors);
    this.highlight();
  }

  /** Show the positions of the map that the model shows. */
  moveNodes() {
    this.positions.write(0, this.model.positions, this.model.dimension);
    this._measure();
    this.highlight();
  }

  /** Mark what is selected, and what is pointed at. */
  highlight() {
    const colors = THEMES[this.theme];
    this._mark("selected", this.model.selected, colors.selected);
    this._mark("hovered", this.hovered, colors.hover);
    this._drawEllipses();
    this.request();
  }

  /** Whether a layer is shown; what belongs to the result alone is hidden with other maps. */
  updateVisibility(wanted) {
    this.wanted = wanted;
    for (const [name, layers] of Object.entries(this.groups)) {
      const shown = wanted[name] !== false && (this.model.isResult || !OF_RESULT.has(name));
      for (const layer of layers) layer.visible = shown;
    }
    this.request();
  }

  shows(name) { return this.groups[name]?.some((layer) => layer.visible) ?? false; }

  /** Side of the dots of nodes in pixels; 0 where they are not drawn. */
  get nodeSize() {
    const side = NODE_PART * this.spacing * this.camera.pixelsPerMeter;
    return side < SMALLEST_NODE ? 0 : Math.min(side, LARGEST_NODE);
  }

  _paintOthers(colors) {
    const { arrays } = this.model, { layers, first } = this;
    layers.gauge.set(Float32Array.from(arrays.gauge), tints(arrays.gauge, constant(colors.gauge)));
    if (layers.truth) {
      const pairs = [];
      const isKnown = (node) => !Number.isNaN(arrays.truth[node * this.model.dimension]);
      for (let k = 0; k < this.model.edgeCount; k++) {
        const [a, b] = this.model.ends(k);
        if (arrays.is_odometry[k] && isKnown(a) && isKnown(b)) pairs.push(first.truth + a, first.truth + b);
      }
      setLines(layers.truth, pairs, colors.truth);
    }
    if (layers.fixes) {
      const fixes = [];
      const pairs = [];
      arrays.prior_nodes.forEach((node, k) => {
        if (Number.isNaN(arrays.fixes[k * this.model.dimension])) return;
        fixes.push(first.fixes + k);
        pairs.push(node, first.fixes + k);
      });
      const color = (k) => rgb(arrays.prior_kept?.[k - first.fixes] === 0 ? colors.rejected : colors.priors);
      layers.fixes.set(Float32Array.from(fixes), tints(fixes, color));
      const ofLine = fixes.map((k) => k);
      layers.priorLines.set(Float32Array.from(pairs), tints(ofLine, color));
    }
    if (layers.landmarks) {
      const all = Float32Array.from({ length: arrays.landmark_ids.length }, (_, k) => first.landmarks + k);
      layers.landmarks.set(all, tints(all, constant(colors.landmarks)));
      const pairs = arrays.observations.map((index, k) => (k % 2 ? first.landmarks + index : index));
      setLines(layers.observations, pairs, colors.observations);
    }
  }

  _mark(name, what, color) {
    let pairs = [], nodes = [];
    if (what?.kind === "edge") {
      pairs = this.model.ends(what.index);
      nodes = pairs;
    } else if (what?.kind === "node") {
      nodes = [what.index];
    } else if (what?.kind === "landmark") {
      nodes = [this.first.landmarks + what.index];
    }
    setLines(this.layers[`${name}Lines`], pairs, color);
    this.layers[`${name}Dots`].set(Float32Array.from(nodes), tints(nodes, constant(color)));
  }

  _drawEllipses() {
    const { selected } = this.model, { arrays } = this.model;
    if (!arrays.covariances) return;
    const colors = THEMES[this.theme];
    const picked = selected?.kind === "node" && this.model.isResult ? [selected.index] : [];
    const nodes = [...this.ellipseNodes, ...picked];
    const size = this.circles * CIRCLE;
    const pairs = nodes.map((node, k) => {
      const begin = this.first.ellipses + k * size;
      this.positions.write(begin, ellipsePoints(this.model, node), this.model.dimension);
      return circlePairs(begin, this.circles);
    });
    const count = this.ellipseNodes.length;
    setLines(this.layers.ellipses, pairs.slice(0, count).flat(), colors.ellipses);
    setLines(this.layers.selectedEllipse, pairs.slice(count).flat(), colors.ellipses);
  }

  /** Measure the lines of each layer, which decides how transparent they are. */
  _measure() {
    const { positions, dimension: d, arrays } = this.model;
    this.lengths = {};
    const steps = [];
    for (const name of EDGE_LAYERS) {
      let sum = 0;
      for (const edge of this.edges[name] ?? []) {
        const a = arrays.ends[2 * edge] * d, b = arrays.ends[2 * edge + 1] * d;
        let square = 0;
        for (let c = 0; c < d; c++) square += (positions[a + c] - positions[b + c]) ** 2;
        sum += Math.sqrt(square);
        if (name === "odometry") steps.push(Math.sqrt(square));
      }
      this.lengths[name] = sum;
    }
    steps.sort((a, b) => a - b);
    this.spacing = steps[steps.length >> 1] || this.camera.radius / Math.sqrt(this.model.nodeCount);
  }

  _scaleLines() {
    const scale = this.camera.pixelsPerMeter, [x, y] = this.camera.halves;
    const area = 4 * Math.max(x, 0.2 * this.camera.radius) * Math.max(y, 0.2 * this.camera.radius);
    for (const name of EDGE_LAYERS) {
      const layer = this.layers[name], [part, faintest] = INK[name];
      const cover = (this.lengths[name] * WIDTHS[name]) / (area * scale);
      layer.uniforms.opacity.value = Math.min(Math.max(part / (cover || 1e-9), faintest), 0.95);
    }
    const size = this.nodeSize;
    this.layers.nodes.uniforms.size.value = size;
    const tooMany = this.level > 1 && this.model.nodeCount > MANY_NODES;
    if (this.wanted) this.layers.nodes.visible = size > 0 && this.wanted.nodes !== false && !tooMany;
    // Dots are measured in pixels of the screen.
    const ratio = this.renderer.getPixelRatio();
    for (const [name, layer] of Object.entries(this.layers)) {
      if (!(layer instanceof Dots)) continue;
      layer.side ??= layer.uniforms.size.value;
      layer.uniforms.size.value = ratio * (name === "nodes" ? size : layer.side);
    }
  }
}
