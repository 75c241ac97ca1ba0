// Colors that people with any kind of color blindness can tell apart: kinds differ in lightness or in
// dashes besides hue, and the lightness of a scale rises or falls all along it.

export const THEMES = {
  light: {
    paper: "#ffffff", odometry: "#12436d", closures: "#e0761a", rejected: "#c2006b", off: "#6b7785",
    nodes: "#12436d", gauge: "#000000", priors: "#007a5a", landmarks: "#6a3d9a", observations: "#a48cc4",
    truth: "#4d4d4d", ellipses: "#0b84b8", selected: "#000000", hover: "#5b6776",
    // Small values are pale, large ones dark.
    heat: ["#c9d6e6", "#e9b872", "#d9661f", "#7f0014"],
    time: ["#b8d8c8", "#5fa8b5", "#3b6ea8", "#2a2466"],
  },
  dark: {
    paper: "#10151c", odometry: "#6fb4ee", closures: "#e8953f", rejected: "#ff5ca8", off: "#8b98a8",
    nodes: "#a8d2f5", gauge: "#ffffff", priors: "#3fd6a5", landmarks: "#c7a6f5", observations: "#7d68a3",
    truth: "#bdbdbd", ellipses: "#6fd3ff", selected: "#ffffff", hover: "#9aa7b7",
    // Small values are dark, large ones bright.
    heat: ["#2b4662", "#a4541f", "#f0a030", "#fff6bf"],
    time: ["#3d3a80", "#3f7fb0", "#63b8a8", "#e6f2b0"],
  },
};

// Okabe and Ito's colors, the yellow one darker so that it shows on white.
const CATEGORIES = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#a89a00", "#8a8a8a"];

/** Return red, green and blue, 0 to 255, of a color such as #12436d. */
export function rgb(hex) {
  const value = parseInt(hex.slice(1), 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}

/** Return the color of a category. */
export function categoryColor(k) {
  return CATEGORIES[k % CATEGORIES.length];
}

/** Return a table of 256 colors, red, green and blue, between the given ones. */
export function ramp(stops) {
  const colors = stops.map(rgb);
  const table = new Uint8Array(256 * 3);
  for (let k = 0; k < 256; k++) {
    const at = (k / 255) * (colors.length - 1);
    const low = Math.min(Math.floor(at), colors.length - 2);
    for (let c = 0; c < 3; c++) {
      table[3 * k + c] = colors[low][c] + (at - low) * (colors[low + 1][c] - colors[low][c]);
    }
  }
  return table;
}
