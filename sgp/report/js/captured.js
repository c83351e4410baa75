// The recorded images nearest to a light, and their shares.

/** Return up to three [index, weight] of directions; weights change without jumps. */
export function nearest(directions, [x, y, z]) {
  const near = directions
    .map(([a, b, c], index) => ({ index, away: 1e-6 + Math.hypot(a - x, b - y, c - z) }))
    .sort((one, other) => one.away - other.away)
    .slice(0, 4);
  // The fourth has no share, so that an image enters and leaves with none.
  const limit = near.length > 3 ? 1 / near[3].away : 0;
  const shares = near.slice(0, 3).map(({ index, away }) => [index, 1 / away - limit]);
  const sum = shares.reduce((total, [, share]) => total + share, 0);
  return shares.map(([index, share]) => [index, sum > 0 ? share / sum : 1 / shares.length]);
}
