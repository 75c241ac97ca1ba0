// What the page knows: the data, which map is shown, what is picked, which edges are switched off.

// Edges that are listed.
const MOST_LISTED = 200;

export class Model {
  constructor(header) {
    this.header = header;
    this.arrays = header.arrays;
    this.dimension = header.dimension;
    this.nodeCount = this.arrays.ids.length;
    this.edgeCount = this.arrays.kept.length;
    this.stateCount = header.states.length;
    this.state = this.stateCount - 1;
    this.selected = null;
    this.coloring = "kind";
    // What the decision rejected is off from the beginning.
    this.isOff = this.arrays.kept.map((kept) => 1 - kept);
    this.listeners = {};
  }

  on(event, listener) { (this.listeners[event] ??= []).push(listener); }
  tell(event) { for (const listener of this.listeners[event] ?? []) listener(); }

  get isResult() { return this.state === this.stateCount - 1; }
  get hasDecision() { return "reason" in this.arrays; }

  /** Positions of the nodes in the map shown, relative to the center. */
  get positions() { return this.positionsOf(this.state); }

  positionsOf(state) {
    const size = this.nodeCount * this.dimension;
    return this.arrays.positions.subarray(state * size, (state + 1) * size);
  }

  /** chi2 of the edges in the map shown. */
  get chi2() {
    return this.arrays.chi2.subarray(this.state * this.edgeCount, (this.state + 1) * this.edgeCount);
  }

  ends(edge) { return [this.arrays.ends[2 * edge], this.arrays.ends[2 * edge + 1]]; }
  id(node) { return this.arrays.ids[node].toString(); }
  name(edge) { return this.ends(edge).map((node) => this.id(node)).join(" → "); }

  point(node) {
    return [...this.positions.subarray(node * this.dimension, (node + 1) * this.dimension)];
  }

  /** The layer that draws an edge. */
  layerOf(edge) {
    if (this.isOff[edge]) return this.arrays.kept[edge] ? "off" : "rejected";
    return this.arrays.is_odometry[edge] ? "odometry" : "closures";
  }

  show(state) {
    const next = Math.min(Math.max(state, 0), this.stateCount - 1);
    if (next === this.state) return;
    this.state = next;
    this.tell("state");
  }

  select(selected) {
    this.selected = selected;
    this.tell("selection");
  }

  color(coloring) {
    this.coloring = coloring;
    this.tell("coloring");
  }

  toggle(edge) {
    this.isOff[edge] = 1 - this.isOff[edge];
    this.tell("off");
  }

  restore() {
    this.isOff = this.arrays.kept.map((kept) => 1 - kept);
    this.tell("off");
  }

  /** Indices of the edges that are off. */
  off() {
    const edges = [];
    for (let k = 0; k < this.edgeCount; k++) if (this.isOff[k]) edges.push(k);
    return edges;
  }

  /** Whether other edges are off than those that the decision rejected. */
  get isEdited() { return this.isOff.some((off, k) => off !== 1 - this.arrays.kept[k]); }

  /** Edges with a property, those with the largest chi2 first. */
  worst(has) {
    const chi2 = this.chi2, edges = [];
    for (let k = 0; k < this.edgeCount; k++) if (has(k)) edges.push(k);
    const rank = (k) => (Number.isNaN(chi2[k]) ? -1 : chi2[k]);
    return edges.sort((a, b) => rank(b) - rank(a) || a - b).slice(0, MOST_LISTED);
  }

  /** Edges at a node, in their order. */
  edgesAt(node) {
    if (!this.incidence) this._index();
    return this.incidence.edges.subarray(this.incidence.first[node], this.incidence.first[node + 1]);
  }

  /** Index of a node by its id as text, or undefined. */
  nodeWithId(text) {
    this.byId ??= new Map(Array.from(this.arrays.ids, (id, k) => [id.toString(), k]));
    return this.byId.get(text);
  }

  /** Index of a landmark by its id as text, or undefined. */
  landmarkWithId(text) {
    const ids = this.arrays.landmark_ids;
    if (!ids) return undefined;
    this.landmarkById ??= new Map(Array.from(ids, (id, k) => [id.toString(), k]));
    return this.landmarkById.get(text);
  }

  _index() {
    const { ends } = this.arrays;
    const first = new Int32Array(this.nodeCount + 1);
    for (const node of ends) first[node + 1]++;
    for (let k = 0; k < this.nodeCount; k++) first[k + 1] += first[k];
    const edges = new Int32Array(ends.length), next = first.slice();
    for (let k = 0; k < ends.length; k++) edges[next[ends[k]]++] = k >> 1;
    this.incidence = { first, edges };
  }
}
