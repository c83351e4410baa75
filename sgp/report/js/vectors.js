// Unit vectors in two octahedral coordinates: decoded, encoded, averaged and smoothed.

/** Samples of a coordinate are 1 to STEPS + 1; 0 means no value. */
export const STEPS = 4094;

/** Return x, y, z of each pixel of a plane of vectors; 0 where it has no value. */
export function decodeVectors(samples) {
  const vectors = new Float32Array((samples.length / 2) * 3);
  for (let i = 0, o = 0; i < samples.length; i += 2, o += 3) {
    if (samples[i] === 0) continue;
    let x = (samples[i] - 1) * (2 / STEPS) - 1;
    let y = (samples[i + 1] - 1) * (2 / STEPS) - 1;
    const z = 1 - Math.abs(x) - Math.abs(y);
    if (z < 0) {
      const folded = (1 - Math.abs(y)) * (x < 0 ? -1 : 1);
      y = (1 - Math.abs(x)) * (y < 0 ? -1 : 1);
      x = folded;
    }
    const length = Math.hypot(x, y, z);
    vectors[o] = x / length;
    vectors[o + 1] = y / length;
    vectors[o + 2] = z / length;
  }
  return vectors;
}

/** The inverse of decodeVectors; vectors need not have unit length, those of length 0 have none. */
export function encodeVectors(vectors) {
  const samples = new Uint16Array((vectors.length / 3) * 2);
  for (let i = 0, o = 0; i < vectors.length; i += 3, o += 2) {
    const length = Math.abs(vectors[i]) + Math.abs(vectors[i + 1]) + Math.abs(vectors[i + 2]);
    if (length === 0) continue;
    let x = vectors[i] / length;
    let y = vectors[i + 1] / length;
    if (vectors[i + 2] < 0) {
      const folded = (1 - Math.abs(y)) * (x < 0 ? -1 : 1);
      y = (1 - Math.abs(x)) * (y < 0 ? -1 : 1);
      x = folded;
    }
    samples[o] = Math.round((x + 1) * (STEPS / 2)) + 1;
    samples[o + 1] = Math.round((y + 1) * (STEPS / 2)) + 1;
  }
  return samples;
}

/** Return vectors smoothed by three box filters of about this standard deviation in pixels. */
export function smoothed(vectors, rows, columns, sigma) {
  const radius = Math.max(1, Math.round(Math.sqrt(sigma * sigma + 0.25) - 0.5));
  let from = Float32Array.from(vectors);
  let to = new Float32Array(vectors.length);
  for (let pass = 0; pass < 3; pass++) {
    boxed(from, to, rows, columns, 3, columns * 3, radius);
    boxed(to, from, columns, rows, columns * 3, 3, radius);
  }
  for (let i = 0; i < vectors.length; i += 3) {
    if (vectors[i] === 0 && vectors[i + 1] === 0 && vectors[i + 2] === 0) {
      from[i] = from[i + 1] = from[i + 2] = 0;
    }
  }
  return from;
}

/** Sum over 2 radius + 1 neighbours along lines; pixels outside count as 0. */
function boxed(from, to, lines, length, step, lineStep, radius) {
  for (let line = 0; line < lines; line++) {
    for (let axis = 0; axis < 3; axis++) {
      const start = line * lineStep + axis;
      let sum = 0;
      for (let i = 0; i < Math.min(radius, length); i++) sum += from[start + i * step];
      for (let i = 0; i < length; i++) {
        if (i + radius < length) sum += from[start + (i + radius) * step];
        if (i - radius - 1 >= 0) sum -= from[start + (i - radius - 1) * step];
        to[start + i * step] = sum / (2 * radius + 1);
      }
    }
  }
}
