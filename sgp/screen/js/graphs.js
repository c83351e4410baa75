// Histogram and history of the focus, drawn as SVG.

import { drawing } from "./elements.js";

const WIDTH = 256;
const HEIGHT = 72;
const HISTORY = 150; // frames

/** Draw a histogram of raw values; heights are logarithmic, the last bar is that of the white level. */
export function drawHistogram(svg, text, { histogram, clipped_fraction: clipped }) {
  const most = Math.log1p(Math.max(...histogram));
  const wide = WIDTH / histogram.length;
  svg.replaceChildren(
    ...histogram.map((count, i) => {
      const high = most > 0 ? (HEIGHT * Math.log1p(count)) / most : 0;
      const full = i === histogram.length - 1 && clipped > 0;
      return drawing("rect", { class: full ? "full" : "area", x: i * wide, y: HEIGHT - high, width: wide, height: high });
    }),
  );
  text.textContent = `Raw values, log; ${(100 * clipped).toFixed(clipped < 0.1 ? 3 : 1)} % clipped`;
}

/** The focus measure over time; it begins again when light, exposure or region change. */
export class FocusHistory {
  constructor(svg, text) {
    Object.assign(this, { svg, text, values: [], best: 0, key: "" });
  }

  add(value, key) {
    if (key !== this.key) Object.assign(this, { values: [], best: 0, key });
    this.values.push(value);
    this.values = this.values.slice(-HISTORY);
    this.best = Math.max(this.best, value);
    const y = (one) => HEIGHT - 4 - ((HEIGHT - 8) * one) / (this.best || 1);
    const points = this.values.map((one, i) => `${(i * WIDTH) / (HISTORY - 1)},${y(one).toFixed(2)}`);
    this.svg.replaceChildren(
      drawing("line", { class: "best", x1: 0, x2: WIDTH, y1: y(this.best), y2: y(this.best) }),
      drawing("polyline", { class: "line", points: points.join(" ") }),
    );
    this.text.textContent = `Focus in view: ${this.best ? ((100 * value) / this.best).toFixed(0) : 0} % of the best`;
  }
}
