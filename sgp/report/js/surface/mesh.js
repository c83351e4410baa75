// A mesh from a height map, and its sections, as typed arrays.

/** Return {positions, uv, index, step, middle}: every `step`-th pixel; heights are relative to `middle`. */
export function meshOf(heights, most) {
  const { columns, rows, pixelSize, height, half } = heights;
  let [low, high, known] = [Infinity, -Infinity, 0];
  for (const value of height) {
    if (Number.isNaN(value)) continue;
    known++;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  const middle = (low + high) / 2;
  const step = Math.max(1, Math.ceil(Math.sqrt(known / most)));
  const [across, down] = [Math.floor((columns - 1) / step) + 1, Math.floor((rows - 1) / step) + 1];
  const [left, top] = [((columns - 1) % step) >> 1, ((rows - 1) % step) >> 1];
  const vertex = new Int32Array(across * down).fill(-1);
  const positions = [];
  const uv = [];
  for (let i = 0, at = 0; i < down; i++) {
    const row = top + i * step;
    for (let j = 0; j < across; j++, at++) {
      const column = left + j * step;
      const value = height[row * columns + column];
      if (Number.isNaN(value)) continue;
      vertex[at] = positions.length / 3;
      const [x, y, z] = heights.point(column * pixelSize - half[0], half[1] - row * pixelSize, value);
      positions.push(x, y, z - middle);
      uv.push((column + 0.5) / columns, 1 - (row + 0.5) / rows);
    }
  }
  // A jump between vertices `step` pixels apart is one between neighbours on the way.
  const cut = (i, j, below) => {
    const [row, column] = [top + i * step, left + j * step];
    for (let k = 0; k < step; k++) {
      if (below ? heights.cut(row + k, column, 1, 0) : heights.cut(row, column + k, 0, 1)) return true;
    }
    return false;
  };
  return {
    positions: new Float32Array(positions),
    uv: new Float32Array(uv),
    index: triangles(vertex, across, down, heights.jumps ? cut : () => false),
    step,
    middle,
    range: [low, high],
  };
}

/** Two triangles for four neighbours, one for three; their front faces the camera, and none spans a jump. */
function triangles(vertex, across, down, cut) {
  const index = [];
  for (let i = 0; i + 1 < down; i++) {
    for (let j = 0; j + 1 < across; j++) {
      const at = i * across + j;
      const [a, b, c, d] = [vertex[at], vertex[at + across], vertex[at + across + 1], vertex[at + 1]];
      const [left, bottom, right, top] = [cut(i, j, 1), cut(i + 1, j, 0), cut(i, j + 1, 1), cut(i, j, 0)];
      const whole = (corners, sides) => (corners.every((one) => one >= 0) && !sides.some(Boolean) ? [corners] : []);
      const one = [...whole([a, b, c], [left, bottom]), ...whole([a, c, d], [right, top])];
      const other = [...whole([a, b, d], [left, top]), ...whole([b, c, d], [bottom, right])];
      index.push(...(one.length >= other.length ? one : other).flat());
    }
  }
  return new Uint32Array(index);
}

/** Return the segments x, y, z, x, y, z in which a plane, such as z = value, cuts the triangles. */
export function section({ positions, index }, axis, value) {
  const segments = [];
  for (let t = 0; t < index.length; t += 3) {
    const above = [0, 1, 2].map((k) => positions[3 * index[t + k] + axis] >= value);
    if (above[0] === above[1] && above[1] === above[2]) continue;
    for (let k = 0; k < 3; k++) {
      if (above[k] === above[(k + 1) % 3]) continue;
      const [a, b] = [3 * index[t + k], 3 * index[t + ((k + 1) % 3)]];
      const share = (value - positions[a + axis]) / (positions[b + axis] - positions[a + axis]);
      for (let c = 0; c < 3; c++) segments.push(positions[a + c] + share * (positions[b + c] - positions[a + c]));
    }
  }
  return segments;
}
