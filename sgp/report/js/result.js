// A result of the page: its planes, decoded when they are needed, and what views get of it.

import { decodePlane, numbers } from "./planes.js";
import { decodeVectors } from "./vectors.js";

export class Result {
  constructor(description) {
    Object.assign(this, description);
    this.decoded = new Map();
  }

  has(name) {
    return this.planes.some((plane) => plane.name === name);
  }

  header(name) {
    return this.planes.find((plane) => plane.name === name);
  }

  /** Return a promise of a plane with its samples, or of null. */
  plane(name) {
    if (!this.decoded.has(name)) {
      const header = this.header(name);
      const text = header && document.getElementById(header.id).textContent;
      this.decoded.set(name, header ? decodePlane(header, text) : Promise.resolve(null));
    }
    return this.decoded.get(name);
  }

  /** Pixels of the finest map for each pixel of the embedded one. */
  get finest() {
    return this.tiles ? this.tiles.columns / this.columns : 1;
  }

  /** Return what views get: decision 60 lists it. */
  async data() {
    const names = ["height", "height_sigma", "normals", "albedo", "jumps"];
    const [height, sigma, normals, albedo, jumps] = await Promise.all(names.map((name) => this.plane(name)));
    const vectors = normals && decodeVectors(normals.samples);
    const values = height && numbers(height);
    const mask = new Uint8Array(this.rows * this.columns);
    for (let i = 0; i < mask.length; i++) {
      mask[i] = values ? Number(values[i] === values[i]) : vectors ? Number(normals.samples[2 * i] > 0) : 1;
    }
    return {
      name: this.name,
      columns: this.columns,
      rows: this.rows,
      pixelSize: this.pixelSize,
      unit: this.unit,
      mask,
      height: values,
      heightStep: height ? height.step : 0,
      sigma: sigma && numbers(sigma),
      normals: vectors,
      jumps: jumps && jumps.samples,
      texture: painted(albedo, this.columns, this.rows),
      full: this.full,
      result: this,
    };
  }
}

function painted(albedo, columns, rows) {
  const canvas = document.createElement("canvas");
  canvas.width = columns;
  canvas.height = rows;
  const pixels = new ImageData(columns, rows);
  for (let i = 0; i < columns * rows; i++) {
    for (let c = 0; c < 3; c++) {
      pixels.data[4 * i + c] = albedo ? albedo.samples[albedo.channels * i + (albedo.channels === 3 ? c : 0)] : 200;
    }
    pixels.data[4 * i + 3] = 255;
  }
  canvas.getContext("2d").putImageData(pixels, 0, 0);
  return canvas;
}
