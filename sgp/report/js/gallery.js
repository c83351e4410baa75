// Small pictures of all maps of numbers, with their scales. They need no WebGL.

import { colourMap, scale } from "./colours.js";
import { element } from "./elements.js";

const MOST = 480; // pixels of a side

/** Fill the elements of class "maps" with the maps of the results. */
export async function drawMaps(results, colourMaps) {
  for (const result of results) {
    const place = document.getElementById(`maps-${result.id}`);
    if (!place) continue;
    for (const header of result.planes.filter((plane) => plane.kind === "scalar")) {
      const samples = colourMap(colourMaps[header.colours] ?? colourMaps.doubt);
      const plane = await result.plane(header.name);
      const title = header.unit ? `${header.label}, ${header.unit}` : header.label;
      place.append(element("figure", {}, painted(plane, samples), scale(samples, ...header.shown, title)));
    }
  }
}

function painted({ samples, rows, columns, low, step, shown, label }, colours) {
  const stride = Math.max(1, Math.ceil(Math.max(rows, columns) / MOST));
  const canvas = element("canvas", { role: "img", "aria-label": `Map: ${label}` });
  canvas.width = Math.ceil(columns / stride);
  canvas.height = Math.ceil(rows / stride);
  const pixels = new ImageData(canvas.width, canvas.height);
  const span = shown[1] - shown[0] || 1;
  for (let row = 0, o = 0; row < rows; row += stride) {
    for (let column = 0; column < columns; column += stride, o += 4) {
      const sample = samples[row * columns + column];
      if (sample === 0) continue;
      const share = (low + step * (sample - 1) - shown[0]) / span;
      const at = 3 * Math.round(255 * Math.min(1, Math.max(0, share)));
      pixels.data.set(colours.subarray(at, at + 3), o);
      pixels.data[o + 3] = 255;
    }
  }
  canvas.getContext("2d").putImageData(pixels, 0, 0);
  return canvas;
}
