// Figures of points on a surface: positions, distances, profiles, areas.

import { roughness } from "./roughness.js";

const MOST_SAMPLES = 4000;
const computed = new WeakMap(); // by the points of a mark

/** Return the figures of 1, 2, or 3 and more points. A number that is not known is NaN. */
export function measured(heights, points) {
  if (points.length === 1) return position(heights, points[0]);
  return points.length === 2 ? distance(heights, ...points) : area(heights, points);
}

function position(heights, [x, y]) {
  return { kind: "point", x, y, height: heights.at(x, y), heightSigma: heights.sigmaAt(x, y) };
}

function distance(heights, a, b) {
  const [first, last] = [a, b].map((place) => heights.point(...place, heights.at(...place)));
  const difference = last[2] - first[2];
  const across = Number.isNaN(difference) ? Math.hypot(b[0] - a[0], b[1] - a[1]) : Math.hypot(last[0] - first[0], last[1] - first[1]);
  return {
    kind: "distance",
    distance: Math.hypot(across, difference),
    across,
    difference,
    differenceSigma: heights.differenceSigma(a, b),
    along: profile(heights, a, b).along,
  };
}

/** Return {across, height, sigma} at steps of at most a pixel from one place to another, and the length along the surface. */
export function profile(heights, a, b) {
  const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
  const steps = Math.min(MOST_SAMPLES, Math.max(1, Math.ceil(length / heights.pixelSize)));
  const way = [(b[0] - a[0]) / (length || 1), (b[1] - a[1]) / (length || 1)];
  const samples = { across: [], height: [], sigma: [], along: 0 };
  const start = heights.point(...a, heights.at(...a) || 0);
  let before = null;
  for (let i = 0; i <= steps; i++) {
    const share = i / steps;
    const place = [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
    const height = heights.at(...place);
    const point = heights.point(...place, height);
    const seen = heights.point(...place, height || 0);
    samples.across.push((seen[0] - start[0]) * way[0] + (seen[1] - start[1]) * way[1]);
    samples.height.push(height);
    if (before) samples.along += Math.hypot(...point.map((value, axis) => value - before[axis]));
    before = point;
    samples.sigma.push(heights.sigmaAt(...place));
  }
  return samples;
}

/** The area of a polygon seen from the front, that of the surface over it, and the share without a surface. */
function area(heights, points) {
  if (crossing(points)) return { kind: "area", area: NaN, surface: NaN, missing: NaN, crossing: true };
  const seen = Math.abs(shoelace(points));
  const { front, surface, missing } = enlargements(heights, points);
  if (computed.get(points)?.heights !== heights) computed.set(points, { heights, found: roughness(heights, points) });
  const { found } = computed.get(points);
  return { kind: "area", area: seen * (Number.isNaN(front) ? 1 : front), surface: seen * (1 - missing) * surface, missing, crossing: false, ...(found && { roughness: found }) };
}

function shoelace(points) {
  return points.reduce((sum, [x, y], i) => {
    const [u, v] = points[(i + 1) % points.length];
    return sum + (x * v - u * y) / 2;
  }, 0);
}

/** Return whether two sides of a polygon that are not neighbours meet. */
function crossing(points) {
  const n = points.length;
  const side = ([ax, ay], [bx, by], [x, y]) => Math.sign((bx - ax) * (y - ay) - (by - ay) * (x - ax));
  for (let i = 0; i < n; i++) {
    for (let j = i + 2; j < n; j++) {
      if (i === 0 && j === n - 1) continue;
      const [a, b, c, d] = [points[i], points[i + 1], points[j], points[(j + 1) % n]];
      if (side(a, b, c) * side(a, b, d) < 0 && side(c, d, a) * side(c, d, b) < 0) return true;
    }
  }
  return false;
}

/** Average the areas of the surface, and of its view from the front, over that of the map in the squares of four pixels inside a polygon. */
function enlargements(heights, points) {
  const { columns, rows, pixelSize, height, half } = heights;
  const pixels = points.map(([x, y]) => [(x + half[0]) / pixelSize, (half[1] - y) / pixelSize]);
  const ys = pixels.map((one) => one[1]);
  const corner = (row, column) => heights.point(column * pixelSize - half[0], half[1] - row * pixelSize, height[row * columns + column]);
  let [surface, front, known, all] = [0, 0, 0, 0];
  for (let row = Math.floor(Math.min(...ys)); row <= Math.max(...ys); row++) {
    const crossed = crossings(pixels, row + 0.5);
    for (let k = 0; k + 1 < crossed.length; k += 2) {
      for (let column = Math.ceil(crossed[k] - 0.5); column + 0.5 < crossed[k + 1]; column++) {
        all++;
        if (row < 0 || column < 0 || row + 1 >= rows || column + 1 >= columns) continue;
        const sides = [[row, column, 0, 1], [row, column, 1, 0], [row + 1, column, 0, 1], [row, column + 1, 1, 0]];
        if (heights.jumps && sides.some((side) => heights.cut(...side))) continue;
        const [a, b, c, d] = [corner(row, column), corner(row, column + 1), corner(row + 1, column), corner(row + 1, column + 1)];
        const halves = [product(b, c, a), product(c, b, d)];
        const found = halves.reduce((sum, one) => sum + Math.hypot(...one) / 2, 0);
        if (Number.isNaN(found)) continue;
        surface += found;
        front += Math.abs(halves[0][2] + halves[1][2]) / 2;
        known++;
      }
    }
  }
  const square = known * pixelSize ** 2;
  return { surface: surface / square, front: front / square, missing: all > 0 ? 1 - known / all : NaN };
}

/** Return the vector product of the ways from `origin` to `p` and to `q`. */
function product(p, q, origin) {
  const [[a, b, c], [d, e, f]] = [p, q].map((one) => one.map((value, axis) => value - origin[axis]));
  return [b * f - c * e, c * d - a * f, a * e - b * d];
}

function crossings(points, y) {
  const found = [];
  points.forEach(([ax, ay], i) => {
    const [bx, by] = points[(i + 1) % points.length];
    if (ay > y !== by > y) found.push(ax + ((y - ay) * (bx - ax)) / (by - ay));
  });
  return found.sort((one, other) => one - other);
}
