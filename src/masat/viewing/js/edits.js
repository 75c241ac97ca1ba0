// The edges that are switched off, and the list of them that `masat solve --without` reads.

import { count, say } from "./format.js";

const FILE_NAME = "edges_off.txt";

/** Return the list of the edges that are off, as text. */
export function offList(model) {
  const off = model.off();
  const lines = [
    `# ${off.length} edges that are switched off in the view "${model.header.title.replace(/\s+/g, " ")}".`,
    "# To make the map without them:  masat solve FILE --without THIS_FILE",
    "# from to index",
    ...off.map((edge) => `${model.ends(edge).map((node) => model.id(node)).join(" ")} ${edge}`),
  ];
  return `${lines.join("\n")}\n`;
}

/** Save the list as a file. */
export function exportOff(model) {
  const off = model.off();
  if (off.length === 0) {
    say("No edge is switched off: pick one and press x.");
    return;
  }
  const url = URL.createObjectURL(new Blob([offList(model)], { type: "text/plain" }));
  const link = document.createElement("a");
  link.href = url;
  link.download = FILE_NAME;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
  say(`${FILE_NAME}: ${count(off.length)} edges. masat solve FILE --without ${FILE_NAME} makes the map without them.`);
}

/** Keep the text and the buttons of the panel up to date. */
export function showOff(model) {
  const off = model.off();
  const rejected = off.filter((edge) => !model.arrays.kept[edge]).length;
  const parts = [`${count(off.length)} of ${count(model.edgeCount)} edges`];
  if (rejected) parts.push(`${count(rejected)} of them rejected by the solve`);
  document.getElementById("off-text").textContent = off.length ? parts.join(", ") : "no edge; pick one and press x";
  document.getElementById("export").disabled = off.length === 0;
  document.getElementById("restore").disabled = !model.isEdited;
}
