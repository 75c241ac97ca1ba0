// Finding nodes, landmarks and edges by what is typed.

/** Return what a text names: { kind, index }, or a sentence that says why there is none. */
export function find(model, text) {
  const words = text.trim().split(/[\s,>→]+|(?<=\d)-+(?=[-\d])/).filter(Boolean);
  const isInteger = (word) => /^-?\d+$/.test(word);
  if (words.length === 1 && /^#\d+$/.test(words[0])) {
    const index = Number(words[0].slice(1));
    return index < model.edgeCount ? { kind: "edge", index } : `There are ${model.edgeCount} edges, from #0 on.`;
  }
  if (words.length === 0 || words.length > 2 || !words.every(isInteger)) {
    return "Type the id of a node, the two ids of an edge, or # and the index of an edge.";
  }
  const nodes = words.map((word) => model.nodeWithId(BigInt(word).toString()));
  if (words.length === 1) {
    if (nodes[0] !== undefined) return { kind: "node", index: nodes[0] };
    const landmark = model.landmarkWithId(BigInt(words[0]).toString());
    return landmark === undefined ? `There is no node ${words[0]}.` : { kind: "landmark", index: landmark };
  }
  const missing = nodes.indexOf(undefined);
  if (missing >= 0) return `There is no node ${words[missing]}.`;
  const between = [...model.edgesAt(nodes[0])].filter((edge) => model.ends(edge).includes(nodes[1]));
  if (between.length === 0) return `No edge joins ${words[0]} and ${words[1]}.`;
  // Searched for again, the next of several edges between two nodes is found.
  const at = model.selected?.kind === "edge" ? between.indexOf(model.selected.index) : -1;
  return { kind: "edge", index: between[(at + 1) % between.length] };
}
