// WebGL2: textures of planes, and one pane of the canvas from them.

import { levelsOf } from "./levels.js";
import { FRAGMENT, MODES, VERTEX } from "./shader.js";

const UNITS = ["uNormals", "uShape", "uScalar", "uHeight", "uInvented", "uAlbedo", "uColours", "uFrameA", "uFrameB", "uFrameC"];

/** Draws panes into a canvas. Throws if there is no WebGL2. */
export class Renderer {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser has no WebGL2; the pictures below show it under eight lights");
    this.gl = gl;
    this.program = linked(gl);
    this.places = new Map();
    gl.useProgram(this.program);
    UNITS.forEach((name, unit) => gl.uniform1i(this.place(name), unit));
    this.unsigned = this.texture([{ columns: 1, rows: 1, samples: new Uint16Array(2) }], "vectors");
    this.picture = this.texture([{ columns: 1, rows: 1, samples: new Uint8Array([200, 200, 200]) }], "colour");
    gl.bindVertexArray(gl.createVertexArray());
  }

  place(name) {
    if (!this.places.has(name)) this.places.set(name, this.gl.getUniformLocation(this.program, name));
    return this.places.get(name);
  }

  /** Return a texture with all levels of a plane, or with the first one alone. */
  planeTexture(plane, single = false) {
    const levels = single ? [plane] : levelsOf(plane);
    const kind = plane.kind === "scalar" && plane.bits === 8 ? "scalar8" : plane.kind;
    return this.texture(plane.kind === "colour" ? levels.map((level) => coloured(level, plane)) : levels, kind);
  }

  texture(levels, kind) {
    const gl = this.gl;
    const [stored, format, type] = {
      vectors: [gl.RG16UI, gl.RG_INTEGER, gl.UNSIGNED_SHORT],
      scalar: [gl.R16UI, gl.RED_INTEGER, gl.UNSIGNED_SHORT],
      scalar8: [gl.R8UI, gl.RED_INTEGER, gl.UNSIGNED_BYTE],
      colour: [gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE],
    }[kind];
    const texture = this.begin(levels.length - 1, gl.NEAREST);
    levels.forEach((level, i) =>
      gl.texImage2D(gl.TEXTURE_2D, i, stored, level.columns, level.rows, 0, format, type, level.samples),
    );
    return texture;
  }

  /** Return a texture of an image element, which is interpolated. */
  imageTexture(image) {
    const gl = this.gl;
    const texture = this.begin(0, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE, image);
    return texture;
  }

  begin(last, filter) {
    const gl = this.gl;
    const texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE15);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAX_LEVEL, last);
    const least = last > 0 ? gl.NEAREST_MIPMAP_NEAREST : filter;
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, least);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return texture;
  }

  discard(texture) {
    this.gl.deleteTexture(texture);
  }

  clear() {
    const gl = this.gl;
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  /**
   * Draw a map, or one of its tiles, into a box of the canvas: mode, textures by name of uniform, and uniforms.
   * `view` is the place of the map on the canvas, and its zoom.
   */
  draw({ box, mode, textures, uniforms, size, levels, view }) {
    const gl = this.gl;
    const { width, height } = gl.canvas;
    gl.viewport(0, 0, width, height);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(box.left, height - box.top - box.height, Math.max(0, box.width), Math.max(0, box.height));
    UNITS.forEach((name, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      const other = unit < 5 ? this.unsigned : this.picture;
      gl.bindTexture(gl.TEXTURE_2D, textures[name] ?? other);
    });
    const level = Math.min(levels - 1, Math.max(0, Math.round(-Math.log2(view.zoom))));
    gl.uniform1i(this.place("uMode"), MODES[mode]);
    gl.uniform1i(this.place("uLevel"), level);
    gl.uniform2i(this.place("uSize"), size.columns, size.rows);
    gl.uniform2f(this.place("uOrigin"), view.x, view.y);
    gl.uniform1f(this.place("uZoom"), view.zoom);
    gl.uniform1f(this.place("uCanvasHeight"), height);
    for (const [name, value] of Object.entries(uniforms)) {
      if (typeof value === "boolean") gl.uniform1i(this.place(name), value ? 1 : 0);
      else if (typeof value === "number") gl.uniform1f(this.place(name), value);
      else if (value.length === 2) gl.uniform2f(this.place(name), ...value);
      else gl.uniform3f(this.place(name), ...value);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

function coloured(level, plane) {
  if (plane.channels === 3) return level;
  const samples = new Uint8Array(level.samples.length * 3);
  for (let i = 0; i < level.samples.length; i++) samples.fill(level.samples[i], 3 * i, 3 * i + 3);
  return { ...level, samples };
}

function linked(gl) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
    throw new Error(`the shader does not compile: ${gl.getProgramInfoLog(program)} ${logs.join(" ")}`);
  }
  return program;
}
