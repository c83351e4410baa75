// Levels of a map: each has half the rows and columns of the one before.

import { decodeVectors, encodeVectors } from "./vectors.js";

const SMALLEST = 64;

/** Return [{columns, rows, samples}, ...], beginning with the plane itself. */
export function levelsOf(plane) {
  const levels = [{ columns: plane.columns, rows: plane.rows, samples: plane.samples }];
  if (plane.kind === "vectors") {
    let vectors = decodeVectors(plane.samples);
    return halved(levels, (last) => {
      vectors = means(vectors, last, 3, () => true);
      return encodeVectors(vectors);
    });
  }
  const counts = plane.kind === "colour" ? () => true : (value) => value > 0;
  return halved(levels, (last) => {
    const sums = means(last.samples, last, plane.channels, counts);
    return plane.samples.constructor.from(sums, Math.round);
  });
}

function halved(levels, next) {
  for (;;) {
    const last = levels[levels.length - 1];
    const columns = last.columns >> 1;
    const rows = last.rows >> 1;
    if (Math.min(columns, rows) < SMALLEST) return levels;
    levels.push({ columns, rows, samples: next(last) });
  }
}

/** Return the means of 2 x 2 pixels, without those that do not count. */
function means(samples, { columns, rows }, channels, counts) {
  const across = columns >> 1;
  const down = rows >> 1;
  const result = new Float32Array(across * down * channels);
  const places = [0, channels, columns * channels, (columns + 1) * channels];
  for (let row = 0, o = 0; row < down; row++) {
    for (let column = 0; column < across; column++) {
      const first = (2 * row * columns + 2 * column) * channels;
      for (let channel = 0; channel < channels; channel++, o++) {
        let sum = 0;
        let count = 0;
        for (const place of places) {
          const value = samples[first + place + channel];
          if (!counts(value)) continue;
          sum += value;
          count++;
        }
        result[o] = count > 0 ? sum / count : 0;
      }
    }
  }
  return result;
}
