// Pointers on the canvas: one turns the light or pans, two zoom; and the place of the map.

const MOST_ZOOM = 32;

/**
 * Where the map lies in a frame {width, height}, which each pane has: x, y of its top left corner and
 * zoom, in pixels of the canvas. `unit` is the zoom at which one pixel of the finest map is one of the canvas.
 */
export class Place {
  constructor(size, unit) {
    Object.assign(this, { frame: { width: 1, height: 1 }, size, unit, x: 0, y: 0, zoom: 1, fitted: true });
  }

  /** Change the frame; what was in its middle stays there. */
  reframe({ width, height }) {
    const [right, down] = [(width - this.frame.width) / 2, (height - this.frame.height) / 2];
    this.frame = { width, height };
    if (this.fitted) return this.fit();
    this.x = Math.round(this.x + right);
    this.y = Math.round(this.y + down);
    this.limit();
  }

  fit() {
    const { width, height } = this.frame;
    this.zoom = Math.min(width / this.size.columns, height / this.size.rows, MOST_ZOOM * this.unit);
    this.x = Math.round((width - this.size.columns * this.zoom) / 2);
    this.y = Math.round((height - this.size.rows * this.zoom) / 2);
    this.fitted = true;
  }

  /** Zoom about a place of the frame, by default its middle. */
  zoomTo(zoom, x = this.frame.width / 2, y = this.frame.height / 2) {
    const least = Math.min(this.unit, 0.5 * Math.min(this.frame.width / this.size.columns, this.frame.height / this.size.rows));
    const next = Math.min(MOST_ZOOM * this.unit, Math.max(least, zoom));
    this.x = x - ((x - this.x) * next) / this.zoom;
    this.y = y - ((y - this.y) * next) / this.zoom;
    if (next === this.unit) [this.x, this.y] = [Math.round(this.x), Math.round(this.y)];
    this.zoom = next;
    this.fitted = false;
    this.limit();
  }

  pan(x, y) {
    this.x += x;
    this.y += y;
    this.fitted = false;
    this.limit();
  }

  /** A part of the map stays in sight. */
  limit() {
    const { width, height } = this.frame;
    this.x = Math.min(0.9 * width, Math.max(0.1 * width - this.size.columns * this.zoom, this.x));
    this.y = Math.min(0.9 * height, Math.max(0.1 * height - this.size.rows * this.zoom, this.y));
  }
}

/** Listen to pointers on a canvas: `drag(x, y, start)` and `pan(dx, dy)`, `zoom(factor, x, y)` in its pixels. */
export function gestures(canvas, { drag, pan, zoom, pans }) {
  const down = new Map();
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    const scale = canvas.width / box.width;
    return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({ preventScroll: true });
    down.set(event.pointerId, place(event));
    if (down.size === 1 && !pans(event)) drag(...place(event), true);
    event.preventDefault();
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!down.has(event.pointerId)) return;
    const before = new Map(down);
    const now = place(event);
    down.set(event.pointerId, now);
    const was = before.get(event.pointerId);
    if (down.size === 1) {
      if (pans(event)) pan(now[0] - was[0], now[1] - was[1]);
      else drag(...now, false);
      return;
    }
    const [a, b] = [...before.values()];
    const [c, d] = [...down.values()];
    pan((c[0] + d[0] - a[0] - b[0]) / 2, (c[1] + d[1] - a[1] - b[1]) / 2);
    const spread = Math.hypot(c[0] - d[0], c[1] - d[1]) / Math.max(1, Math.hypot(a[0] - b[0], a[1] - b[1]));
    zoom(spread, (c[0] + d[0]) / 2, (c[1] + d[1]) / 2);
  });
  const end = (event) => down.delete(event.pointerId);
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      zoom(Math.exp(-event.deltaY / 400), ...place(event));
    },
    { passive: false },
  );
}
