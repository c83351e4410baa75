// Parameters of a rectangle (ISO 25178-2), as `sgp roughness --form plane --l-mm 0` measures them, noise included.

const DIGITS = [1, 2, 2.5, 5, 8]; // nesting indices of ISO 25178-3
const NESTING = [-4, -3, -2, -1, 0, 1, 2].flatMap((power) => DIGITS.map((digit) => Number(`${digit}e${power}`)));
const LEAST_PIXELS = 5; // of the nesting index of an S-filter
const HALF = Math.PI * Math.sqrt(2 / Math.log(2)); // a Gaussian of deviation 1 transmits half of a wave of this length
const DEVIATION = Math.sqrt(Math.log(2) / Math.PI) / Math.sqrt(2 * Math.PI); // of an S-filter, in nesting indices
const LEAST_VARIANCE = 1e-4;
const REACH = 5.5;
const LEAST_SPREAD = 0.05;

/** Return the rectangle {column, row, columns, rows} of pixels whose outer middles are the corners; null for another polygon. */
export function rectangleOf(heights, points) {
  if (points.length !== 4) return null;
  const [a, b, c, d] = points;
  if (a[0] !== d[0] || b[0] !== c[0] || a[1] !== b[1] || c[1] !== d[1]) return null;
  const [first, last] = [pixelOf(heights, [Math.min(a[0], b[0]), Math.max(a[1], c[1])]), pixelOf(heights, [Math.max(a[0], b[0]), Math.min(a[1], c[1])])];
  return { column: first[0], row: first[1], columns: last[0] - first[0] + 1, rows: last[1] - first[1] + 1 };
}

/** Return the corners of the rectangle between two places, at the middles of their pixels. */
export function corners(heights, [a, b]) {
  const middles = [a, b].map((place) => {
    const [column, row] = pixelOf(heights, place);
    return heights.rounded([column * heights.pixelSize - heights.half[0], heights.half[1] - row * heights.pixelSize]);
  });
  const [[x, y], [u, v]] = middles;
  return [[x, y], [u, y], [u, v], [x, v]];
}

function pixelOf({ half, pixelSize }, [x, y]) {
  return [Math.round((x + half[0]) / pixelSize), Math.round((half[1] - y) / pixelSize)];
}

/** Return the parameters in µm of a rectangle, {region, sFilter, Sa, ...}; of one that is too small, only these two; null if they are not defined. */
export function roughness(heights, points) {
  const box = heights.roughness && rectangleOf(heights, points);
  if (!box) return null;
  const { blur, origin, reduction } = heights.roughness;
  const pixel = heights.pixelSize * (1 - (heights.camera ? mean(heights.height) / heights.camera.distance : 0));
  const removed = Math.sqrt(blur ** 2 / reduction ** 2 + (1 - 1 / reduction ** 2) / 12);
  const least = Math.max(HALF * removed, 2, LEAST_PIXELS) * pixel;
  const sFilter = NESTING.find((one) => one >= least) ?? least;
  const region = reduction > 1 ? null : [origin[0] + box.column, origin[1] + box.row, box.columns, box.rows].join(",");
  const part = cut(heights, box, Math.ceil(sFilter / pixel));
  if (part.side * pixel < sFilter) return { region, sFilter };
  smooth(part, missing(sFilter / pixel, removed));
  level(part);
  const values = Float64Array.from(part.inside.filter((i) => !Number.isNaN(part.values[i])), (i) => 1000 * part.values[i]);
  return { region, sFilter, ...parameters(values) };
}

/** Return {columns, rows, values, inside, side}: the heights of a rectangle and what is known up to a margin around its heights, and where it is. */
function cut(heights, box, margin) {
  const known = [];
  for (let row = box.row; row < box.row + box.rows; row++) {
    for (let column = box.column; column < box.column + box.columns; column++) {
      if (!Number.isNaN(heights.height[row * heights.columns + column])) known.push([row, column]);
    }
  }
  const ends = (axis) => known.reduce(([low, high], one) => [Math.min(low, one[axis]), Math.max(high, one[axis])], [Infinity, -Infinity]);
  const [[top, bottom], [left, right]] = [ends(0), ends(1)];
  const [first, start] = [Math.max(0, top - margin), Math.max(0, left - margin)];
  const [last, stop] = [Math.min(heights.rows - 1, bottom + margin), Math.min(heights.columns - 1, right + margin)];
  const [rows, columns] = [last - first + 1, stop - start + 1];
  if (known.length === 0) return { side: 0 };
  const values = new Float64Array(rows * columns);
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) values[row * columns + column] = heights.height[(row + first) * heights.columns + column + start];
  }
  const inside = known.map(([row, column]) => (row - first) * columns + column - start);
  const middle = inside.reduce((sum, i) => sum + values[i], 0) / inside.length;
  for (let i = 0; i < values.length; i++) values[i] -= middle;
  return { columns, rows, values, inside, side: Math.min(bottom - top, right - left) + 1 };
}

/** Return the deviation of weights that remove what a filter still removes after a blur, in pixels; 0 for none. */
function missing(nesting, removed) {
  const variance = (DEVIATION * nesting) ** 2 - removed ** 2;
  if (variance <= LEAST_VARIANCE) return 0;
  if (variance > 1) return Math.sqrt(variance);
  // Samples of a narrow Gaussian have a smaller variance than the Gaussian.
  let [low, high] = [0.1, 1.1];
  for (let i = 0; i < 60; i++) {
    const scale = (low + high) / 2;
    let [sum, square] = [0, 0];
    for (let offset = -8; offset <= 8; offset++) {
      const weight = Math.exp(-0.5 * (offset / scale) ** 2);
      sum += weight;
      square += weight * offset ** 2;
    }
    if (square / sum < variance) low = scale;
    else high = scale;
  }
  return (low + high) / 2;
}

/** Replace heights by those of the planes that are fitted around each with Gaussian weights (ISO/TS 16610-28). */
function smooth(part, scale) {
  if (scale === 0) return;
  const { columns, rows, values } = part;
  const reach = Math.max(1, Math.ceil(REACH * scale));
  const weight = Float64Array.from({ length: 2 * reach + 1 }, (_, i) => Math.exp(-0.5 * ((i - reach) / scale) ** 2));
  const total = weight.reduce((sum, one) => sum + one, 0);
  const powers = [0, 1, 2].map((power) => weight.map((one, i) => (one / total) * (i - reach) ** power));
  const along = (image, kernel, count, step, other, stride) => {
    const found = new Float64Array(image.length);
    for (let j = 0; j < other; j++) {
      for (let i = 0; i < count; i++) {
        let sum = 0;
        for (let k = Math.max(-reach, -i); k <= Math.min(reach, count - 1 - i); k++) sum += kernel[k + reach] * image[j * stride + (i + k) * step];
        found[j * stride + i * step] = sum;
      }
    }
    return found;
  };
  const moments = (image, wanted) => {
    const across = [0, 1, 2].map((x) => (wanted.some((one) => one[0] === x) ? along(image, powers[x], columns, 1, rows, columns) : null));
    return wanted.map(([x, y]) => along(across[x], powers[y], rows, columns, columns, 1));
  };
  const known = values.map((value) => Number(!Number.isNaN(value)));
  const [w, wx, wy, wxx, wxy, wyy] = moments(known, [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]]);
  const [v, vx, vy] = moments(values.map((value) => value || 0), [[0, 0], [1, 0], [0, 1]]);
  const spread = LEAST_SPREAD * powers[2].reduce((sum, one) => sum + one, 0);
  for (let i = 0; i < values.length; i++) {
    if (known[i] === 0) continue;
    const [x, y, middle] = [wx[i] / w[i], wy[i] / w[i], v[i] / w[i]];
    const [xx, xy, yy] = [wxx[i] / w[i] - x * x, wxy[i] / w[i] - x * y, wyy[i] / w[i] - y * y];
    const narrow = (xx + yy) / 2 - Math.hypot((xx - yy) / 2, xy) <= spread;
    const [across, down] = [vx[i] / w[i] - x * middle, vy[i] / w[i] - y * middle];
    const right = yy * across - xy * down;
    const up = xx * down - xy * across;
    values[i] = narrow ? NaN : middle - (right * x + up * y) / (xx * yy - xy * xy);
  }
}

/** Subtract the plane that fits all heights best. */
function level({ columns, values }) {
  const sums = new Float64Array(9);
  const place = (i) => [i % columns, Math.floor(i / columns)];
  const each = (visit) => values.forEach((value, i) => !Number.isNaN(value) && visit(value, ...place(i), i));
  each((value, x, y) => [1, x, y, value].forEach((one, k) => (sums[k] += one)));
  const [n, mx, my, mz] = [sums[0], sums[1] / sums[0], sums[2] / sums[0], sums[3] / sums[0]];
  each((value, x, y) => {
    const [a, b, c] = [x - mx, y - my, value - mz];
    [a * a, a * b, b * b, a * c, b * c].forEach((one, k) => (sums[k + 4] += one / n));
  });
  const [xx, xy, yy, xz, yz] = sums.slice(4);
  const determinant = xx * yy - xy * xy;
  const [right, down] = [(yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant];
  each((value, x, y, i) => (values[i] = value - mz - right * (x - mx) - down * (y - my)));
}

function parameters(values) {
  const middle = mean(values);
  const power = (k) => values.reduce((sum, value) => sum + (value - middle) ** k, 0) / values.length;
  const Sq = Math.sqrt(power(2));
  const [low, high] = values.reduce(([a, b], value) => [Math.min(a, value), Math.max(b, value)], [Infinity, -Infinity]);
  const Sa = values.reduce((sum, value) => sum + Math.abs(value - middle), 0) / values.length;
  return { Sa, Sq, Sz: high - low, Ssk: power(3) / Sq ** 3, Sku: power(4) / Sq ** 4 };
}

function mean(values) {
  let [sum, count] = [0, 0];
  for (const value of values) {
    if (Number.isNaN(value)) continue;
    sum += value;
    count++;
  }
  return sum / count;
}
