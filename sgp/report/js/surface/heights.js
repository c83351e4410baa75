// Heights at any place of a map. Places have x to the right and y up from the middle of the map.

export class Heights {
  /**
   * `differences`: {distances, sigma} of differences in height, or null. `camera`: {distance, axis} of a
   * perspective camera, its axis at [x, y], or null. `jumps`: 1 at a pixel with a jump to the right, 2 below, or null.
   * `roughness`: {blur, origin, reduction} of the map if its roughness is defined, or null.
   */
  constructor({ columns, rows, pixelSize, unit, height, sigma, camera = null, jumps = null, roughness = null }, differences = null) {
    Object.assign(this, { columns, rows, pixelSize, unit, height, sigma, differences, camera, jumps, roughness });
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

  /** Return the point x, y, z that the camera sees at a place, whose height is z. */
  point(x, y, z) {
    if (!this.camera) return [x, y, z];
    const { distance, axis } = this.camera;
    const share = 1 - z / distance;
    return [axis[0] + (x - axis[0]) * share, axis[1] + (y - axis[1]) * share, z];
  }

  /** Return whether the surface jumps between a pixel and one to its right (below it), or on the way to a diagonal one. */
  cut(row, column, down, right) {
    if (!this.jumps) return false;
    const at = row * this.columns + column;
    const across = (place) => right !== 0 && (this.jumps[right > 0 ? place : place - 1] & 1) !== 0;
    const along = (place) => down !== 0 && (this.jumps[down > 0 ? place : place - this.columns] & 2) !== 0;
    if (down === 0 || right === 0) return across(at) || along(at);
    return (across(at) || along(at + right)) && (along(at) || across(at + down * this.columns));
  }

  /** Return the height at a place, or NaN. */
  at(x, y) {
    return this.value(this.height, x, y);
  }

  /** Return the standard deviation of the height at a place, or NaN. */
  sigmaAt(x, y) {
    return this.sigma ? this.value(this.sigma, x, y) : NaN;
  }

  /** Interpolate between those of the four pixels around a place that hang together with the nearest one; NaN if that has no value. */
  value(map, x, y) {
    const [halfWidth, halfHeight] = this.half;
    const column = (x + halfWidth) / this.pixelSize;
    const row = (halfHeight - y) / this.pixelSize;
    const known = (r, c) => (r >= 0 && c >= 0 && r < this.rows && c < this.columns ? map[r * this.columns + c] : NaN);
    const [nearRow, nearColumn] = [Math.round(row), Math.round(column)];
    if (Number.isNaN(known(nearRow, nearColumn))) return NaN;
    const [top, left] = [Math.floor(row), Math.floor(column)];
    let [sum, weights] = [0, 0];
    for (const [r, c] of [[top, left], [top, left + 1], [top + 1, left], [top + 1, left + 1]]) {
      const weight = (1 - Math.abs(row - r)) * (1 - Math.abs(column - c));
      const value = known(r, c);
      if (!(weight > 0) || Number.isNaN(value) || this.cut(nearRow, nearColumn, r - nearRow, c - nearColumn)) continue;
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
