// Tiles of full resolution: decoded and kept on the graphics card while they are in view.

import { decodePlane } from "./planes.js";

const MOST = 40; // tiles that are kept for a pane, each with all planes of its mode
const BORDER = 1; // pixels of the neighbours on each side

export class Tiles {
  constructor(renderer, redraw) {
    Object.assign(this, { renderer, redraw, kept: new Map(), pending: 0 });
  }

  /** Return the tiles in view whose planes are decoded, as parts to draw; the others are begun. */
  visible(result, names, { x, y, zoom, box }) {
    const { side, rows, columns } = result.tiles;
    const step = result.finest;
    const fine = zoom / step; // pixels of the canvas for each pixel of the tiles
    const range = (start, length, origin, most) => [
      Math.max(0, Math.floor((start - origin) / fine / side)),
      Math.min(Math.ceil(most / side) - 1, Math.floor((start + length - origin) / fine / side)),
    ];
    const [top, bottom] = range(box.top, box.height, y, rows);
    const [left, right] = range(box.left, box.width, x, columns);
    const found = [];
    for (let row = top; row <= bottom; row++) {
      for (let column = left; column <= right; column++) {
        const tile = this.tile(result, names, row, column);
        if (tile.textures === null) continue;
        const offset = [Math.max(0, column * side - BORDER), Math.max(0, row * side - BORDER)];
        const part = clipped(box, x + column * side * fine, y + row * side * fine, side * fine);
        if (part.width <= 0 || part.height <= 0) continue;
        found.push({
          step,
          x: x + offset[0] * fine,
          y: y + offset[1] * fine,
          zoom: fine,
          box: part,
          size: tile.size,
          offset,
          levels: 1,
          texture: (name) => tile.textures.get(name),
        });
      }
    }
    return found;
  }

  tile(result, names, row, column) {
    const key = [result.id, row, column, ...names].join(" ");
    const kept = this.kept.get(key) ?? { textures: null, size: null };
    // The one that was used last is at the end.
    this.kept.delete(key);
    this.kept.set(key, kept);
    if (kept.size === null) {
      kept.size = result.tiles.headers[`${names[0]}-${row}-${column}`];
      this.load(result, names, row, column, kept);
    }
    return kept;
  }

  async load(result, names, row, column, kept) {
    this.pending += 1;
    const textures = new Map();
    for (const name of names) {
      const header = result.tiles.headers[`${name}-${row}-${column}`];
      if (!header) continue;
      const plane = await decodePlane(header, document.getElementById(header.id).textContent);
      textures.set(name, this.renderer.planeTexture(plane, true));
    }
    kept.textures = textures;
    this.pending -= 1;
    for (const [key, old] of this.kept) {
      if (this.kept.size <= MOST) break;
      if (old.textures === null || old === kept) continue;
      for (const texture of old.textures.values()) this.renderer.discard(texture);
      this.kept.delete(key);
    }
    this.redraw();
  }
}

/** Return the part of a box that a square covers, in whole pixels. */
function clipped(box, x, y, side) {
  const left = Math.max(box.left, Math.round(x));
  const top = Math.max(box.top, Math.round(y));
  const right = Math.min(box.left + box.width, Math.round(x + side));
  const bottom = Math.min(box.top + box.height, Math.round(y + side));
  return { left, top, width: right - left, height: bottom - top };
}
