// What can be laid on a surface: pictures of the size of its map.

import { colourMap } from "../colours.js";

const GREY = 190;

/** Return [key, label] of the textures of a result. */
export function texturesOf(data) {
  const found = [["plain", "plain"], ["height", "height"]];
  if (data.result.has("albedo")) found.unshift(["albedo", "albedo"]);
  if (data.sigma) found.push(["sigma", "standard deviation of the height"]);
  return found;
}

/** Return a texture as a canvas, and {samples, low, high, title} of its scale or null. */
export async function texture(name, data, colourMaps) {
  if (name === "albedo") return { picture: data.texture, scale: null };
  if (name === "plain") return { picture: painted(data, () => [GREY, GREY, GREY]), scale: null };
  const plane = await data.result.plane(name === "height" ? "height" : "height_sigma");
  const samples = colourMap(colourMaps[plane.colours] ?? colourMaps.doubt);
  const [low, high] = plane.shown;
  const values = name === "height" ? data.height : data.sigma;
  const colour = (i) => {
    const share = Math.min(1, Math.max(0, (values[i] - low) / (high - low || 1)));
    const at = 3 * Math.round(255 * (share || 0));
    return samples.subarray(at, at + 3);
  };
  return { picture: painted(data, colour), scale: { samples, low, high, title: `${plane.label}, ${plane.unit}` } };
}

function painted({ columns, rows }, colour) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [columns, rows];
  const pixels = new ImageData(columns, rows);
  for (let i = 0; i < columns * rows; i++) {
    pixels.data.set(colour(i), 4 * i);
    pixels.data[4 * i + 3] = 255;
  }
  canvas.getContext("2d").putImageData(pixels, 0, 0);
  return canvas;
}
