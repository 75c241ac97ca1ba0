// Lines with a width in pixels, and dots. Both read the positions of nodes from one texture, so that
// another map is shown by writing that texture alone.

const FETCH = `
uniform highp sampler2D positions;
vec3 positionOf(float index) {
  int k = int(index), columns = textureSize(positions, 0).x;
  return texelFetch(positions, ivec2(k % columns, k / columns), 0).xyz;
}
`;

// What lies farther away is paler: fade.x is where that begins, fade.y how strong it becomes a meter.
const DEPTH = `
uniform vec2 fade;
float paleness(float depth) { return clamp((depth - fade.x) * fade.y, 0.0, 0.75); }
`;

export const LINE_VERTEX = `
attribute vec2 ends;
attribute vec4 tint;
uniform vec2 resolution;
uniform float width;
uniform float near;
varying vec4 color;
varying float across;
varying vec2 along;
varying float pale;
${FETCH}${DEPTH}
void main() {
  float end = float(gl_VertexID >> 1 & 1), side = float(gl_VertexID & 1) * 2.0 - 1.0;
  vec4 a = modelViewMatrix * vec4(positionOf(ends.x), 1.0);
  vec4 b = modelViewMatrix * vec4(positionOf(ends.y), 1.0);
  // What lies behind the camera has no place on the screen.
  bool hidden = tint.a == 0.0;
  if (near > 0.0) {
    hidden = hidden || (a.z > -near && b.z > -near);
    if (a.z > -near) a = mix(b, a, (b.z + near) / (b.z - a.z));
    else if (b.z > -near) b = mix(a, b, (a.z + near) / (a.z - b.z));
  }
  if (hidden) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    return;
  }
  vec4 from = projectionMatrix * a, to = projectionMatrix * b;
  vec2 p = from.xy / from.w * resolution * 0.5, q = to.xy / to.w * resolution * 0.5;
  float reach = distance(p, q);
  vec2 ahead = reach > 1e-4 ? (q - p) / reach : vec2(1.0, 0.0);
  // One pixel more, over which the edge of the line fades.
  across = side * (0.5 * width + 1.0);
  vec4 at = mix(from, to, end);
  at.xy += vec2(-ahead.y, ahead.x) * across * 2.0 / resolution * at.w;
  gl_Position = at;
  color = tint;
  along = vec2(end * reach * at.w, at.w);
  pale = paleness(-mix(a.z, b.z, end));
}
`;

export const LINE_FRAGMENT = `
uniform float width;
uniform float opacity;
uniform vec2 dash;
uniform vec3 paper;
varying vec4 color;
varying float across;
varying vec2 along;
varying float pale;
void main() {
  float cover = clamp(0.5 * width + 0.5 - abs(across), 0.0, 1.0) * min(width, 1.0);
  if (dash.x > 0.0 && mod(along.x / along.y, dash.x + dash.y) > dash.x) discard;
  if (cover < 0.02) discard;
  gl_FragColor = vec4(mix(color.rgb, paper, pale), cover * opacity * color.a);
}
`;

// Lines of one pixel, which cost a fifth: large maps are drawn by them while they move.
export const PLAIN_VERTEX = `
attribute float node;
attribute vec4 tint;
varying vec4 color;
varying float pale;
${FETCH}${DEPTH}
void main() {
  vec4 at = modelViewMatrix * vec4(positionOf(node), 1.0);
  gl_Position = projectionMatrix * at;
  color = tint;
  pale = paleness(-at.z);
}
`;

export const PLAIN_FRAGMENT = `
uniform float opacity;
uniform vec3 paper;
varying vec4 color;
varying float pale;
void main() { gl_FragColor = vec4(mix(color.rgb, paper, pale), opacity); }
`;

export const DOT_VERTEX = `
attribute float node;
attribute vec4 tint;
uniform float size;
varying vec4 color;
varying float pale;
${FETCH}${DEPTH}
void main() {
  vec4 at = modelViewMatrix * vec4(positionOf(node), 1.0);
  gl_Position = tint.a == 0.0 ? vec4(2.0, 2.0, 2.0, 1.0) : projectionMatrix * at;
  gl_PointSize = size + 1.0;
  color = tint;
  pale = paleness(-at.z);
}
`;

// Shapes: 0 a disc, 1 a ring, 2 a diamond, 3 a cross.
export const DOT_FRAGMENT = `
uniform float size;
uniform float opacity;
uniform int shape;
uniform vec3 paper;
varying vec4 color;
varying float pale;
void main() {
  vec2 at = (gl_PointCoord - 0.5) * (size + 1.0);
  float radius = 0.5 * size;
  float inside = radius - length(at);
  if (shape == 1) inside = min(inside, length(at) - radius + 2.5);
  if (shape == 2) inside = 0.7 * (radius - abs(at.x) - abs(at.y));
  if (shape == 3) inside = min(min(inside, 1.0), 1.0 - 0.7 * abs(abs(at.x) - abs(at.y)));
  float cover = clamp(inside + 0.5, 0.0, 1.0);
  if (cover < 0.02) discard;
  gl_FragColor = vec4(mix(color.rgb, paper, pale), cover * opacity * color.a);
}
`;
