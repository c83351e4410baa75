// The plot of a profile: height over distance, with a band of one standard deviation.

import { drawing } from "../elements.js";
import { ticks, written } from "../colours.js";

const HEIGHT = 240;
const [LEFT, RIGHT, TOP, BOTTOM] = [74, 12, 12, 44];

/** Draw {across, height, sigma} of a profile, so wide that its letters have the size of the page. */
export function profilePlot({ across, height, sigma }, unit, width) {
  const spread = (i) => (Number.isNaN(sigma[i]) ? 0 : sigma[i]);
  const known = across.map((_, i) => i).filter((i) => !Number.isNaN(height[i]));
  let low = Math.min(...known.map((i) => height[i] - spread(i)));
  let high = Math.max(...known.map((i) => height[i] + spread(i)));
  if (!(high > low)) [low, high] = [low - 0.5, high + 0.5];
  const margin = 0.05 * (high - low);
  [low, high] = [low - margin, high + margin];
  const x = (value) => LEFT + (value / (across.at(-1) || 1)) * (width - LEFT - RIGHT);
  const y = (value) => TOP + ((high - value) / (high - low)) * (HEIGHT - TOP - BOTTOM);
  const at = (i, value) => `${x(across[i]).toFixed(2)} ${y(value).toFixed(2)}`;
  const parts = runs(known);
  const line = parts.map((run) => `M${run.map((i) => at(i, height[i])).join("L")}`).join("");
  const band = parts
    .map((run) => [...run.map((i) => at(i, height[i] + spread(i))), ...run.toReversed().map((i) => at(i, height[i] - spread(i)))])
    .map((points) => `M${points.join("L")}Z`)
    .join("");
  return drawing(
    "svg",
    { viewBox: `0 0 ${width} ${HEIGHT}`, class: "profile", role: "img", "aria-label": `Profile: height over a distance of ${across.at(-1).toPrecision(4)} ${unit}` },
    ...grid(ticks(low, high, 5), (value, step) => [
      drawing("line", { x1: LEFT, x2: width - RIGHT, y1: y(value), y2: y(value), class: "grid" }),
      drawing("text", { x: LEFT - 6, y: y(value) + 4, "text-anchor": "end" }, written(value, step)),
    ]),
    ...grid(ticks(0, across.at(-1) || 1, width / 90), (value, step) => [
      drawing("line", { x1: x(value), x2: x(value), y1: TOP, y2: HEIGHT - BOTTOM, class: "grid" }),
      drawing("text", { x: x(value), y: HEIGHT - BOTTOM + 16, "text-anchor": "middle" }, written(value, step)),
    ]),
    drawing("path", { d: band, class: "band" }),
    drawing("path", { d: line, class: "line" }),
    drawing("text", { x: (LEFT + width - RIGHT) / 2, y: HEIGHT - 8, "text-anchor": "middle" }, `Distance seen from the front, ${unit}`),
    drawing("text", { transform: `translate(14 ${(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)`, "text-anchor": "middle" }, `Height, ${unit}`),
  );
}

function grid(values, one) {
  const step = values.length > 1 ? values[1] - values[0] : 1;
  return values.flatMap((value) => one(value, step));
}

/** Split numbers into runs of successive ones. */
function runs(numbers) {
  const found = [];
  for (const number of numbers) {
    if (found.at(-1)?.at(-1) === number - 1) found.at(-1).push(number);
    else found.push([number]);
  }
  return found;
}

/** Return a profile as a table of comma-separated values. */
export function profileTable({ across, height, sigma }, unit) {
  const cell = (value) => (Number.isNaN(value) ? "" : String(Number(value.toPrecision(8))));
  const rows = across.map((_, i) => [across[i], height[i], sigma[i]].map(cell).join(","));
  return `distance_${unit},height_${unit},sigma_${unit}\n${rows.join("\n")}\n`;
}
