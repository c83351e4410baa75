// One pane of the canvas: a result in a mode.

import { nearest } from "./captured.js";
import { modesOf } from "./modes.js";
import { Tiles } from "./tiles.js";
import { decodeVectors, encodeVectors, smoothed } from "./vectors.js";

const TAIL = 0.02; // share of the curvatures beyond the scale

/** A pane; `prepare` loads what its mode needs, `draw` draws a part of the canvas. */
export class Pane {
  constructor(renderer, maps, results, index, redraw) {
    Object.assign(this, { renderer, maps, mode: "", textures: new Map(), smoothing: 0 });
    this.result = results[Math.min(index, results.length - 1)];
    this.columns = results[0].columns;
    this.tiles = new Tiles(renderer, redraw);
    const offered = modesOf(this.result).map(([key]) => key);
    // The second pane shows another result in the same way, or the same result in another one.
    const wanted = index === 0 || results.length > 1 ? ["shaded", "matte"] : ["detail", "matte", "normals"];
    this.mode = wanted.find((key) => offered.includes(key)) ?? offered[0];
    this.curvature = 1;
    this.ready = false;
  }

  async prepare({ smoothing }) {
    const { result } = this;
    for (const name of needs(this.mode)) {
      const header = result.header(name);
      if (header) await this.load(result, header, header.kind === "vectors" ? smoothing : 0);
    }
    if (this.mode === "captured") await this.loadImages(result);
    if (this.mode === "curvature") this.curvature = spread(await this.vectors(result, smoothing), result);
    this.smoothing = smoothing;
    this.shown = { result, mode: this.mode };
    this.ready = true;
  }

  key(result, name, smoothing) {
    return `${result.id} ${name} ${smoothing}`;
  }

  async load(result, header, smoothing) {
    const key = this.key(result, header.name, smoothing);
    if (this.textures.has(key)) return;
    // Other smoothings of the map are not kept.
    for (const [other, texture] of this.textures) {
      if (!other.startsWith(`${result.id} ${header.name} `)) continue;
      this.renderer.discard(texture);
      this.textures.delete(other);
    }
    const plane = await result.plane(header.name);
    const samples = smoothing > 0 ? encodeVectors(await this.vectors(result, smoothing, header.name)) : plane.samples;
    this.textures.set(key, this.renderer.planeTexture({ ...plane, samples }));
  }

  async loadImages(result) {
    for (const { id } of result.images) {
      if (this.textures.has(id)) continue;
      const image = document.getElementById(id);
      await image.decode();
      this.textures.set(id, this.renderer.imageTexture(image));
    }
  }

  /** Return the recorded images that are nearest to the light, as [image, share]. */
  captured(light) {
    const { result, mode } = this.shown ?? {};
    if (mode !== "captured") return [];
    const found = nearest(result.images.map((image) => image.direction), light.direction);
    return found.map(([index, share]) => [result.images[index], share]);
  }

  async vectors(result, smoothing, name = "normals") {
    const plane = await result.plane(name);
    const decoded = decodeVectors(plane.samples);
    return smoothing > 0 ? smoothed(decoded, plane.rows, plane.columns, smoothing) : decoded;
  }

  /** Draw into a box of the canvas; `view` is the place of the map on it. */
  draw({ box, view, light, look }) {
    if (!this.ready) return;
    const { result, mode } = this.shown;
    // All results are shown as wide as the first one.
    const zoom = (view.zoom * this.columns) / result.columns;
    const whole = { step: 1, x: view.x, y: view.y, zoom, box, size: result, offset: [0, 0], levels: levels(result) };
    const texture = (name) => this.textures.get(this.key(result, name, ["normals", "shape"].includes(name) ? this.smoothing : 0));
    this.drawPart(whole, texture, light, look);
    if (!result.tiles || mode === "captured" || this.smoothing > 0 || zoom <= 1) return;
    const names = needs(mode).filter((name) => result.has(name));
    for (const tile of this.tiles.visible(result, names, whole)) this.drawPart(tile, tile.texture, light, look);
  }

  /** Draw the whole map, or a tile, whose pixels are `step` times finer. */
  drawPart({ step, x, y, zoom, box, size, offset, levels }, texture, light, look) {
    const { result, mode } = this.shown;
    const scalar = mode.startsWith("map:") ? result.header(mode.slice(4)) : null;
    const height = result.header("height");
    const wide = [result.columns * step, result.rows * step];
    const diagonal = Math.hypot(...wide);
    const pixelSize = result.pixelSize / step;
    const images = this.captured(light);
    const uniforms = {
      uFrameWeights: [0, 1, 2].map((i) => images[i]?.[1] ?? 0),
      uLight: light.near ? light.direction.map((v) => v * light.distance * diagonal) : light.direction,
      uNear: light.near,
      uReference: light.distance * diagonal,
      uHasShape: result.has("shape"),
      uHasHeight: Boolean(height),
      uHasAlbedo: result.has("albedo"),
      uHeightStep: height ? [(height.low - (height.shown[0] + height.shown[1]) / 2) / pixelSize, height.step / pixelSize] : [0, 0],
      uOffset: offset,
      uWhole: wide,
      uMark: look.marked && (result.has("invented") || result.has("significant")),
      uOutline: result.has("significant"),
      uExaggeration: look.exaggeration,
      uGain: look.gain,
      uGloss: look.gloss,
      uShine: look.shine,
      uPixelSize: pixelSize,
      uCurvatureRange: this.curvature,
      uScalarRange: scalar ? scalar.shown.map((value) => (value - scalar.low) / scalar.step + 1) : [0, 1],
    };
    const textures = {
      uNormals: texture("normals"),
      uShape: texture("shape"),
      uAlbedo: texture("albedo"),
      uHeight: texture("height"),
      uInvented: texture("significant") ?? texture("invented"),
      uScalar: scalar && texture(scalar.name),
      ...Object.fromEntries(images.map(([image], i) => [`uFrame${"ABC"[i]}`, this.textures.get(image.id)])),
      uColours: this.colours(scalar ? scalar.colours : "signed"),
    };
    this.renderer.draw({ box, mode: scalar ? "scalar" : mode, textures, uniforms, size, levels, view: { x, y, zoom } });
  }

  colours(name) {
    const key = `colours ${name}`;
    if (!this.textures.has(key)) {
      const samples = this.maps[name] ?? this.maps.doubt;
      this.textures.set(key, this.renderer.texture([{ columns: 256, rows: 1, samples }], "colour"));
    }
    return this.textures.get(key);
  }

  /** Return the colour scale of the mode, or null. */
  legend() {
    if (!this.ready) return null;
    const { result, mode } = this.shown;
    if (mode === "curvature") {
      return { samples: this.maps.signed, low: -this.curvature, high: this.curvature, title: `Mean curvature, 1/${result.unit}, convex positive` };
    }
    if (!mode.startsWith("map:")) return null;
    const { shown, label, unit, colours } = result.header(mode.slice(4));
    return { samples: this.maps[colours] ?? this.maps.doubt, low: shown[0], high: shown[1], title: unit ? `${label}, ${unit}` : label };
  }
}

/** Return the names of the planes that a mode needs. */
function needs(mode) {
  const names = mode.startsWith("map:") ? [mode.slice(4)] : ["normals", "shape", "albedo", "height"];
  return [...new Set([...names, "invented", "significant"])];
}

/** Return the number of levels that the renderer makes for the maps of a result. */
function levels({ columns, rows }) {
  let count = 1;
  for (let least = Math.min(columns, rows) >> 1; least >= 64; least >>= 1) count++;
  return count;
}

/** Return a curvature that few pixels exceed. */
function spread(vectors, { rows, columns, pixelSize }) {
  const found = [];
  const stride = Math.max(1, Math.floor(Math.sqrt((rows * columns) / 40000)));
  for (let row = 1; row < rows - 1; row += stride) {
    for (let column = 1; column < columns - 1; column += stride) {
      const at = 3 * (row * columns + column);
      const around = [at + 3, at - 3, at - 3 * columns, at + 3 * columns];
      if (around.some((i) => vectors[i + 2] === 0)) continue;
      const across = vectors[around[0]] - vectors[around[1]];
      const down = vectors[around[2] + 1] - vectors[around[3] + 1];
      found.push(Math.abs(across + down) / (4 * pixelSize));
    }
  }
  if (found.length === 0) return 1;
  found.sort((a, b) => a - b);
  return found[Math.floor((1 - TAIL) * (found.length - 1))] || 1e-6;
}
