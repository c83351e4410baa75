// Colour maps of numbers, and their scales.

import { drawing, element } from "./elements.js";

/** Return the 256 x 3 samples of a colour map from base64. */
export function colourMap(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/** Return round values between two numbers. */
export function ticks(low, high, most = 6) {
  const rough = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough * 0.999);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(i * step);
  return found;
}

/** Return a number with as many digits as its neighbours on a scale need. */
export function written(value, step) {
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  if (digits > 6 || Math.abs(value) >= 1e6) return value.toExponential(1);
  return value.toFixed(digits).replace("-", "\u2212");
}

/** Return a colour scale: its title, and a bar with ticks. */
export function scale(samples, low, high, title) {
  const width = 260;
  const parts = [];
  for (let i = 0; i < 64; i++) {
    const [r, g, b] = samples.subarray(12 * i, 12 * i + 3);
    parts.push(drawing("rect", { x: 20 + (i * width) / 64, y: 22, width: width / 64 + 0.5, height: 12, fill: `rgb(${r},${g},${b})` }));
  }
  const values = high > low ? ticks(low, high) : [low];
  const step = values.length > 1 ? values[1] - values[0] : Math.abs(low) || 1;
  const marks = values.flatMap((value) => {
    const x = 20 + (high > low ? ((value - low) / (high - low)) * width : 0);
    return [
      drawing("line", { x1: x, x2: x, y1: 34, y2: 39, class: "tick" }),
      drawing("text", { x, y: 51, "text-anchor": "middle" }, written(value, step)),
    ];
  });
  const bar = drawing(
    "svg",
    { viewBox: "0 20 300 36", class: "scale", role: "img", "aria-label": `${title}: scale from ${written(low, step)} to ${written(high, step)}` },
    ...parts,
    ...marks,
  );
  return element("div", {}, element("p", { class: "scale-title" }, title), bar);
}
