// Heights at any place of a map. Places have x to the right and y up from the middle of the map.

export class Heights {
  /** `differences`: {distances, sigma} of differences in height, or null. */
  constructor({ columns, rows, pixelSize, unit, height, sigma }, differences = null) {
    Object.assign(this, { columns, rows, pixelSize, unit, height, sigma, differences });
    this.digits = Math.max(0, Math.ceil(-Math.log10(pixelSize / 20)));
  }

  /** Half the width and half the height of the map, between the middles of its outer pixels. */
  get half() {
    return [((this.columns - 1) / 2) * this.pixelSize, ((this.rows - 1) / 2) * this.pixelSize];
  }

  /** Return a place with as many digits as a twentieth of a pixel needs. */
  rounded([x, y]) {
    return [Number(x.toFixed(this.digits)), Number(y.toFixed(this.digits))];
  }

  /** Return the height at a place, or NaN. */
  at(x, y) {
    return this.value(this.height, x, y);
  }

  /** Return the standard deviation of the height at a place, or NaN. */
  sigmaAt(x, y) {
    return this.sigma ? this.value(this.sigma, x, y) : NaN;
  }

  /** Interpolate between the four pixels around a place; NaN if the nearest one has no value. */
  value(map, x, y) {
    const [halfWidth, halfHeight] = this.half;
    const column = (x + halfWidth) / this.pixelSize;
    const row = (halfHeight - y) / this.pixelSize;
    const known = (r, c) => (r >= 0 && c >= 0 && r < this.rows && c < this.columns ? map[r * this.columns + c] : NaN);
    if (Number.isNaN(known(Math.round(row), Math.round(column)))) return NaN;
    const [top, left] = [Math.floor(row), Math.floor(column)];
    let [sum, weights] = [0, 0];
    for (const [r, c] of [[top, left], [top, left + 1], [top + 1, left], [top + 1, left + 1]]) {
      const weight = (1 - Math.abs(row - r)) * (1 - Math.abs(column - c));
      const value = known(r, c);
      if (!(weight > 0) || Number.isNaN(value)) continue;
      sum += weight * value;
      weights += weight;
    }
    return sum / weights;
  }

  /** Return the standard deviation of the difference in height of two places, or NaN. */
  differenceSigma(a, b) {
    const across = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (this.differences) return between(this.differences.distances, this.differences.sigma, across);
    return Math.hypot(this.sigmaAt(...a), this.sigmaAt(...b));
  }
}

/** Interpolate; from 0 at 0, and constant beyond the last position. */
function between(positions, values, position) {
  const next = positions.findIndex((one) => one >= position);
  if (next < 0) return values.at(-1);
  const [low, start] = next > 0 ? [positions[next - 1], values[next - 1]] : [0, 0];
  return start + ((values[next] - start) * (position - low)) / (positions[next] - low);
}
