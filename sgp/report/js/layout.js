// Where the panes lie on the canvas.

/** Layouts of the view: [key, label]. */
export const LAYOUTS = [
  ["one", "one picture"],
  ["divider", "two, with a divider"],
  ["side", "two, side by side"],
];

/** Return {left, top, width, height, x, y} of each pane; x and y are where its map's place begins. */
export function boxes(layout, divider, { width, height }) {
  const box = (left, top, wide, high, x, y) => ({ left, top, width: wide, height: high, x, y });
  if (layout === "one") return [box(0, 0, width, height, 0, 0)];
  if (layout === "divider") {
    const middle = Math.round(divider * width);
    return [box(0, 0, middle, height, 0, 0), box(middle, 0, width - middle, height, 0, 0)];
  }
  const gap = Math.max(2, Math.round(Math.max(width, height) / 250));
  // On a canvas that is higher than wide, the second picture is below the first.
  if (height > width) {
    const half = Math.max(1, (height - gap) >> 1);
    return [box(0, 0, width, half, 0, 0), box(0, height - half, width, half, 0, height - half)];
  }
  const half = Math.max(1, (width - gap) >> 1);
  return [box(0, 0, half, height, 0, 0), box(width - half, 0, half, height, width - half, 0)];
}

/** Return the box that contains a place of the canvas, else the first. */
export function boxAt(all, x, y) {
  return all.find((one) => x >= one.left && x < one.left + one.width && y >= one.top && y < one.top + one.height) ?? all[0];
}
