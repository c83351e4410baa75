// Figures of points on a surface: positions, distances, profiles, areas.

const MOST_SAMPLES = 4000;

/** Return the figures of 1, 2, or 3 and more points. A number that is not known is NaN. */
export function measured(heights, points) {
  if (points.length === 1) return position(heights, points[0]);
  return points.length === 2 ? distance(heights, ...points) : area(heights, points);
}

function position(heights, [x, y]) {
  return { kind: "point", x, y, height: heights.at(x, y), heightSigma: heights.sigmaAt(x, y) };
}

function distance(heights, a, b) {
  const across = Math.hypot(b[0] - a[0], b[1] - a[1]);
  const difference = heights.at(...b) - heights.at(...a);
  return {
    kind: "distance",
    distance: Math.hypot(across, difference),
    across,
    difference,
    differenceSigma: heights.differenceSigma(a, b),
    along: alongSurface(profile(heights, a, b)),
  };
}

/** Return {across, height, sigma} at steps of at most a pixel from one place to another. */
export function profile(heights, a, b) {
  const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
  const steps = Math.min(MOST_SAMPLES, Math.max(1, Math.ceil(length / heights.pixelSize)));
  const samples = { across: [], height: [], sigma: [] };
  for (let i = 0; i <= steps; i++) {
    const share = i / steps;
    const place = [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
    samples.across.push(share * length);
    samples.height.push(heights.at(...place));
    samples.sigma.push(heights.sigmaAt(...place));
  }
  return samples;
}

function alongSurface({ across, height }) {
  let sum = 0;
  for (let i = 1; i < across.length; i++) sum += Math.hypot(across[i] - across[i - 1], height[i] - height[i - 1]);
  return sum;
}

/** The area of a polygon seen from the front, that of the surface over it, and the share without a surface. */
function area(heights, points) {
  if (crossing(points)) return { kind: "area", area: NaN, surface: NaN, missing: NaN, crossing: true };
  const seen = Math.abs(shoelace(points));
  const { mean, missing } = steepness(heights, points);
  return { kind: "area", area: seen, surface: seen * (1 - missing) * mean, missing, crossing: false };
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

/** Average the area of the surface over that of the map in the squares of four pixels inside a polygon. */
function steepness({ columns, rows, pixelSize, height, half }, points) {
  const pixels = points.map(([x, y]) => [(x + half[0]) / pixelSize, (half[1] - y) / pixelSize]);
  const ys = pixels.map((one) => one[1]);
  let [sum, known, all] = [0, 0, 0];
  for (let row = Math.floor(Math.min(...ys)); row <= Math.max(...ys); row++) {
    const crossed = crossings(pixels, row + 0.5);
    for (let k = 0; k + 1 < crossed.length; k += 2) {
      for (let column = Math.ceil(crossed[k] - 0.5); column + 0.5 < crossed[k + 1]; column++) {
        all++;
        if (row < 0 || column < 0 || row + 1 >= rows || column + 1 >= columns) continue;
        const at = row * columns + column;
        const [a, b, c, d] = [height[at], height[at + 1], height[at + columns], height[at + columns + 1]];
        const found = (Math.hypot(1, (b - a) / pixelSize, (c - a) / pixelSize) + Math.hypot(1, (d - c) / pixelSize, (d - b) / pixelSize)) / 2;
        if (Number.isNaN(found)) continue;
        sum += found;
        known++;
      }
    }
  }
  return { mean: sum / known, missing: all > 0 ? 1 - known / all : NaN };
}

function crossings(points, y) {
  const found = [];
  points.forEach(([ax, ay], i) => {
    const [bx, by] = points[(i + 1) % points.length];
    if (ay > y !== by > y) found.push(ax + ((y - ay) * (bx - ax)) / (by - ay));
  });
  return found.sort((one, other) => one - other);
}
