// What lies over the picture: marks with their numbers, the axes, and the scale bar.

import { drawing } from "../elements.js";
import { written } from "../colours.js";
import { profile } from "./measure.js";

const MOST_SAMPLES = 300;
const LETTERS = 24;

/** Return a drawing that covers the stage, and functions that draw on it. */
export function overlay() {
  const marks = drawing("g", {});
  const frame = drawing("g", {});
  const body = drawing("svg", { class: "overlay", "aria-hidden": "true" }, marks, frame);
  return {
    body,
    draw(scene, heights, shown) {
      marks.replaceChildren(...shown.flatMap((mark) => drawn(scene, heights, mark)));
      frame.replaceChildren(...axes(scene), ...scaleBar(scene, heights.unit));
    },
  };
}

/** Draw {points, label, open}: an open mark is still being set. */
function drawn(scene, heights, { points, label, open, selected }) {
  const closed = points.length > 2 && !open;
  const sides = points.slice(1).map((end, i) => [points[i], end]);
  if (closed) sides.push([points.at(-1), points[0]]);
  const steps = sides.map(([a, b]) => draped(scene, heights, a, b)).join("");
  const dots = points.map(([x, y]) => [x, y, heights.at(x, y)]).filter((one) => !Number.isNaN(one[2])).map((one) => scene.project(one));
  const name = selected ? "mark selected" : "mark";
  const parts = steps ? [drawing("path", { d: steps, class: "halo" }), drawing("path", { d: steps, class: name })] : [];
  parts.push(...dots.map(([cx, cy]) => drawing("circle", { cx, cy, r: 4, class: name })));
  if (dots.length > 0 && label) {
    const short = label.length > LETTERS ? `${label.slice(0, LETTERS - 1)}…` : label;
    parts.push(drawing("text", { x: dots[0][0] + 8, y: dots[0][1] - 8 }, short));
  }
  return parts;
}

/** Return a path that follows the surface between two places. */
function draped(scene, heights, a, b) {
  const { across, height } = profile(heights, a, b);
  const last = across.length - 1;
  const stride = Math.max(1, Math.ceil(last / MOST_SAMPLES));
  let path = "";
  let pen = "M";
  for (let i = 0; i <= last; i = i < last ? Math.min(last, i + stride) : last + 1) {
    if (Number.isNaN(height[i])) {
      pen = "M";
      continue;
    }
    const [x, y] = scene.project([a[0] + (i / last) * (b[0] - a[0]), a[1] + (i / last) * (b[1] - a[1]), height[i]]);
    path += `${pen}${x.toFixed(1)} ${y.toFixed(1)}`;
    pen = "L";
  }
  return path;
}

function axes(scene) {
  const [left, top] = [34, 40];
  return scene.axes().flatMap(([x, y], axis) => {
    const line = drawing("line", { x1: left, y1: top, x2: left + 24 * x, y2: top + 24 * y, class: "axis" });
    const text = drawing("text", { x: left + 32 * x, y: top + 32 * y, class: "direction" }, "xyz"[axis]);
    return Math.hypot(x, y) > 0.15 ? [line, text] : [];
  });
}

function scaleBar(scene, unit) {
  const [width, height] = scene.size;
  const most = Math.min(220, 0.4 * width) / scene.scale;
  const power = 10 ** Math.floor(Math.log10(most));
  const length = [5, 2, 1].map((one) => one * power).find((one) => one <= most);
  const long = length * scene.scale;
  const [left, top] = [14, height - 14];
  const heights = scene.exaggeration === 1 ? "" : `, heights × ${written(scene.exaggeration, 0.1)}`;
  const text = `${Number(length.toPrecision(3))} ${unit}${heights}`;
  const path = `M${left} ${top - 4}v8m0 -4h${long}m0 -4v8`;
  return [drawing("path", { d: path, class: "under" }), drawing("path", { d: path, class: "ruler" }), drawing("text", { x: left, y: top - 8 }, text)];
}
