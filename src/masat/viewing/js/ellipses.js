// The ellipse of a position's covariance in 2D; in 3D three circles of its ellipsoid.

// Standard deviations that 95 % of a normal distribution in 2D or 3D are within.
const SIGMAS_95 = { 2: 2.4477, 3: 2.7955 };
// Points of a circle.
export const CIRCLE = 32;

/** Return the coordinates of the points of a node's ellipse, one after another. */
export function ellipsePoints(model, node) {
  const d = model.dimension, size = (d * (d + 1)) / 2;
  const root = cholesky(model.arrays.covariances.subarray(node * size, (node + 1) * size), d);
  const center = model.point(node), points = [];
  for (let circle = 0; circle < (d === 2 ? 1 : 3); circle++) {
    for (let k = 0; k < CIRCLE; k++) {
      const angle = (2 * Math.PI * k) / CIRCLE, u = [0, 0, 0];
      u[circle] = SIGMAS_95[d] * Math.cos(angle);
      u[(circle + 1) % d] = SIGMAS_95[d] * Math.sin(angle);
      // The points of a unit circle, times the root, lie on the ellipse.
      for (let r = 0; r < d; r++) {
        let sum = center[r];
        for (let c = 0; c <= r; c++) sum += root[r][c] * u[c];
        points.push(sum);
      }
    }
  }
  return points;
}

/** Return pairs of indices that join the points of circles, which begin at an index. */
export function circlePairs(begin, circles) {
  const pairs = [];
  for (let circle = 0; circle < circles; circle++) {
    const first = begin + circle * CIRCLE;
    for (let k = 0; k < CIRCLE; k++) pairs.push(first + k, first + ((k + 1) % CIRCLE));
  }
  return pairs;
}

/** Return the lower root L, L L' = C, of a covariance given by its upper triangle. */
function cholesky(upper, d) {
  const c = Array.from({ length: d }, () => new Array(d).fill(0)), root = c.map((row) => row.slice());
  let k = 0;
  for (let i = 0; i < d; i++) for (let j = i; j < d; j++) c[i][j] = c[j][i] = upper[k++];
  for (let i = 0; i < d; i++) {
    for (let j = 0; j <= i; j++) {
      let sum = c[i][j];
      for (let l = 0; l < j; l++) sum -= root[i][l] * root[j][l];
      root[i][j] = i === j ? Math.sqrt(Math.max(sum, 0)) : root[j][j] > 0 ? sum / root[j][j] : 0;
    }
  }
  return root;
}
