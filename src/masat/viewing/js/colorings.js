// How edges and nodes are colored: one number or category for each, and what the legend says of it.

import { THEMES, categoryColor, ramp, rgb } from "./colors.js";

// Edges beyond this quantile of chi2 have the last color; one huge chi2 must not take the whole scale.
const HIGHEST = 0.999;
// Edges with less than this fraction of the highest chi2 have the first color.
const SPAN = 1e-2;

/** Return the colorings that the data allows: key and text. */
export function colorings(model) {
  const { arrays, header } = model;
  const found = [["kind", "Kind of edge"], ["chi2", "chi2"]];
  found.push(["time", arrays.stamps ? "Time" : "Order of the nodes"]);
  if (arrays.session) found.push(["session", "Session"]);
  if (arrays.component) found.push(["component", "Component"]);
  if (arrays.weights) found.push(["weight", "Robust weight"]);
  if (header.labels) found.push(["label", "Label"]);
  return found;
}

/** What colors edges and nodes: functions that write red, green and blue, and a legend. */
export function painter(model, theme) {
  const make = { chi2: byChi2, time: byTime, session: byGroup, component: byGroup, weight: byWeight, label: byLabel };
  return make[model.coloring]?.(model, THEMES[theme]) ?? { legend: { kind: "kinds" } };
}

function scale(table, part) {
  const k = 3 * Math.round(255 * Math.min(Math.max(part, 0), 1));
  return [table[k], table[k + 1], table[k + 2]];
}

function byChi2(model, colors) {
  const table = ramp(colors.heat), chi2 = model.chi2;
  const positive = chi2.filter((value, k) => value > 0 && !model.isOff[k]).sort();
  const high = positive.length ? positive[Math.floor(HIGHEST * (positive.length - 1))] : 1;
  const low = high * SPAN, span = Math.log(high / low);
  return {
    edge: (k) => scale(table, chi2[k] > low ? Math.log(chi2[k] / low) / span : 0),
    order: (edges) => edges.sort((a, b) => (chi2[a] || 0) - (chi2[b] || 0)),
    legend: { kind: "scale", name: "chi2 of the edge", table, ticks: [low, Math.sqrt(low * high), high] },
  };
}

function byTime(model, colors) {
  const table = ramp(colors.time), { stamps } = model.arrays;
  const end = stamps ? stamps.reduce((a, b) => Math.max(a, b), 0) : model.nodeCount - 1;
  const at = (node) => (stamps ? stamps[node] : node) / (end || 1);
  const legend = stamps
    ? { name: "time after the first node [s]", ticks: [0, end / 2, end] }
    : { name: "id of the node", ticks: [0, (model.nodeCount - 1) >> 1, model.nodeCount - 1].map((k) => model.id(k)) };
  return {
    edge: (k) => scale(table, Math.max(...model.ends(k).map(at))),
    node: (k) => scale(table, at(k)),
    legend: { kind: "scale", table, ...legend },
  };
}

function byGroup(model, colors) {
  const group = model.arrays[model.coloring];
  const between = rgb(colors.off), name = model.coloring;
  const count = group.reduce((a, b) => Math.max(a, b), 0) + 1;
  const entries = Array.from({ length: Math.min(count, 8) }, (_, k) => [categoryColor(k), `${name} ${k}`]);
  if (count > 8) entries.push([colors.paper, `${count} in all: colors repeat`]);
  if (name === "session") entries.push([colors.off, "between sessions"]);
  return {
    edge: (k) => {
      const [a, b] = model.ends(k);
      return group[a] === group[b] ? rgb(categoryColor(group[a])) : between;
    },
    node: (k) => rgb(categoryColor(group[k])),
    legend: { kind: "categories", entries },
  };
}

function byWeight(model, colors) {
  const table = ramp(colors.heat), { weights } = model.arrays;
  return {
    edge: (k) => scale(table, 1 - weights[k]),
    order: (edges) => edges.sort((a, b) => weights[b] - weights[a]),
    legend: { kind: "scale", name: "robust weight of the edge", table, ticks: [1, 0.5, 0] },
  };
}

function byLabel(model) {
  const { label } = model.arrays;
  const entries = model.header.labels.slice(0, 12).map((text, k) => [categoryColor(k), text]);
  return {
    edge: (k) => rgb(categoryColor(label[k])),
    legend: { kind: "categories", entries },
  };
}
