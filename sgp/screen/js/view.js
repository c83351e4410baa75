// The live picture: it always asks for the next frame of what is in view, and for no more than it can draw.

import { element } from "./elements.js";
import { Place, gestures } from "./gestures.js";

const STEP = 60; // pixels of the screen that an arrow key moves the picture
const ZOOM = 1.3;

/** The canvas with the live picture; `seen(region)` is called when another region is in view. */
export class View {
  constructor(canvas, caption, seen) {
    Object.assign(this, { canvas, caption, seen, number: 0, after: 0, image: null, region: null, mmPerPx: null });
    this.marks = { clipped: true, peaking: false, cross: false, grid: false };
    this.place = new Place({ columns: 1, rows: 1 }, 1);
    new ResizeObserver(() => this.resized()).observe(canvas);
    gestures(canvas, {
      drag: () => {},
      pan: (x, y) => this.moved(() => this.place.pan(x, y)),
      zoom: (factor, x, y) => this.moved(() => this.place.zoomTo(this.place.zoom * factor, x, y)),
      pans: () => true,
    });
    canvas.addEventListener("keydown", (event) => this.key(event));
    this.follow();
  }

  /** Set the size of a frame, [rows, columns]. */
  size([rows, columns]) {
    const { size } = this.place;
    if (size.rows === rows && size.columns === columns) return;
    this.place = new Place({ columns, rows }, 1);
    this.resized();
  }

  resized() {
    const { clientWidth, clientHeight } = this.canvas;
    this.canvas.width = clientWidth * devicePixelRatio;
    this.canvas.height = clientHeight * devicePixelRatio;
    this.moved(() => this.place.reframe({ width: this.canvas.width, height: this.canvas.height }));
  }

  fit() {
    this.moved(() => this.place.fit());
  }

  /** Show each pixel of the frame as one of the screen. */
  full() {
    this.moved(() => this.place.zoomTo(1));
  }

  key(event) {
    const moves = { ArrowLeft: [STEP, 0], ArrowRight: [-STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
    if (moves[event.key]) this.moved(() => this.place.pan(...moves[event.key]));
    else if (event.key === "+") this.moved(() => this.place.zoomTo(this.place.zoom * ZOOM));
    else if (event.key === "-") this.moved(() => this.place.zoomTo(this.place.zoom / ZOOM));
    else if (event.key === "0") this.fit();
    else if (event.key === "1") this.full();
    else return;
    event.preventDefault();
  }

  moved(change) {
    change();
    this.draw();
    clearTimeout(this.later);
    this.later = setTimeout(() => {
      this.seen(this.inView());
      this.renew();
    }, 300);
  }

  /** Ask for the latest frame again, as it is now in view; there may be no newer one. */
  renew() {
    this.after = 0;
    this.asking?.abort();
  }

  /** Return the region of the frame that is in view, in its pixels. */
  inView() {
    const { place, canvas } = this;
    const { columns, rows } = place.size;
    const left = Math.max(0, Math.floor(-place.x / place.zoom));
    const top = Math.max(0, Math.floor(-place.y / place.zoom));
    const right = Math.min(columns, Math.ceil((canvas.width - place.x) / place.zoom));
    const bottom = Math.min(rows, Math.ceil((canvas.height - place.y) / place.zoom));
    return { left, top, width: Math.max(1, right - left), height: Math.max(1, bottom - top) };
  }

  /** Ask for one frame after another, for as long as the page lives. */
  async follow() {
    for (;;) {
      try {
        await this.next();
      } catch (error) {
        if (error.name !== "AbortError") await new Promise((done) => setTimeout(done, 500));
      }
    }
  }

  async next() {
    const region = this.inView();
    const { zoom } = this.place;
    this.asking = new AbortController();
    const wanted = {
      after: this.after,
      ...region,
      columns: Math.ceil(region.width * Math.min(1, zoom)),
      rows: Math.ceil(region.height * Math.min(1, zoom)),
      clipped: Number(this.marks.clipped),
      peaking: Number(this.marks.peaking),
    };
    const answer = await fetch(`frame?${new URLSearchParams(wanted)}`, { signal: this.asking.signal });
    if (answer.status === 204) return;
    if (!answer.ok) throw new Error(answer.statusText);
    const { number, leds, region: shown } = JSON.parse(answer.headers.get("X-Frame"));
    const image = await createImageBitmap(await answer.blob());
    this.image?.close();
    Object.assign(this, { number, after: number, image, region: shown, leds });
    this.draw();
  }

  draw() {
    const { canvas, place, image } = this;
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, canvas.width, canvas.height);
    if (!image) return;
    const [left, top, width, height] = this.region;
    // The last block of a reduced picture may reach beyond the region.
    const block = Math.max(1, Math.ceil(width / image.width), Math.ceil(height / image.height));
    context.imageSmoothingEnabled = place.zoom < 1;
    context.drawImage(
      image,
      place.x + left * place.zoom,
      place.y + top * place.zoom,
      image.width * block * place.zoom,
      image.height * block * place.zoom,
    );
    if (this.marks.grid) this.lines(context, [1 / 3, 2 / 3]);
    if (this.marks.cross) this.lines(context, [1 / 2]);
    if (this.mmPerPx) this.scaleBar(context);
    this.caption.textContent = `${lit(this.leds)}, frame ${this.number}, ${Math.round(place.zoom * 100)} %`;
  }

  lines(context, shares) {
    const { x, y, zoom, size } = this.place;
    const [width, height] = [size.columns * zoom, size.rows * zoom];
    for (const [colour, wide] of [["#000", 3], ["#fff", 1]]) {
      context.strokeStyle = colour;
      context.lineWidth = wide;
      context.beginPath();
      for (const share of shares) {
        context.moveTo(x + share * width, y);
        context.lineTo(x + share * width, y + height);
        context.moveTo(x, y + share * height);
        context.lineTo(x + width, y + share * height);
      }
      context.stroke();
    }
  }

  scaleBar(context) {
    const most = (0.25 * this.canvas.width * this.mmPerPx) / this.place.zoom;
    const power = 10 ** Math.floor(Math.log10(most));
    const mm = [5, 2, 1].find((one) => one * power <= most) * power;
    const long = (mm / this.mmPerPx) * this.place.zoom;
    const [x, y] = [16, this.canvas.height - 20];
    context.fillStyle = "#000";
    context.fillRect(x - 2, y - 2, long + 4, 8);
    context.fillStyle = "#fff";
    context.fillRect(x, y, long, 4);
    context.font = `${13 * devicePixelRatio}px system-ui`;
    context.strokeStyle = "#000";
    context.lineWidth = 3;
    context.strokeText(`${mm} mm`, x, y - 6);
    context.fillText(`${mm} mm`, x, y - 6);
  }

  /** Return the buttons below the picture. */
  buttons() {
    const button = (text, action) => element("button", { type: "button", onclick: action }, text);
    const toggle = (text, name) =>
      element(
        "button",
        {
          type: "button",
          "aria-pressed": String(this.marks[name]),
          onclick: (event) => {
            this.marks[name] = !this.marks[name];
            event.target.setAttribute("aria-pressed", String(this.marks[name]));
            this.draw();
            this.renew();
          },
        },
        text,
      );
    return [
      button("Fit", () => this.fit()),
      button("1:1", () => this.full()),
      toggle("Clipped", "clipped"),
      toggle("Peaking", "peaking"),
      toggle("Crosshair", "cross"),
      toggle("Grid", "grid"),
    ];
  }
}

function lit(leds) {
  if (leds.length === 0) return "all LEDs off";
  return leds.length === 1 ? `LED ${leds[0]}` : `mean of ${leds.length} LEDs`;
}
