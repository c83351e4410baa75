// The relightable view: one or two panes of a canvas under one light.

import { remember, remembered } from "./address.js";
import { colourMap, scale } from "./colours.js";
import { animation, later, picker } from "./controls.js";
import { element, selection, slider } from "./elements.js";
import { Place, gestures } from "./gestures.js";
import { LAYOUTS, boxAt, boxes } from "./layout.js";
import { Light, RAKING_DEG, dome, turnByKey } from "./light.js";
import { modesOf } from "./modes.js";
import { Pane } from "./pane.js";
import { Renderer } from "./renderer.js";

export const label = "Light";

export function mount(body, { results, report }) {
  const canvas = element("canvas", {
    tabindex: 0,
    role: "img",
    "aria-label": "The result under a light. Arrow keys turn the light, with Shift they move the picture, + and - zoom, 0 fits, 1 shows one pixel per pixel",
  });
  const renderer = new Renderer(canvas);
  const maps = Object.fromEntries(Object.entries(report.colourMaps).map(([name, text]) => [name, colourMap(text)]));
  const light = new Light();
  const look = { exaggeration: 1, smoothing: 0, gain: 1, gloss: 0.5, shine: 30, marked: results.every((one) => one.marked) };
  const place = new Place(results[0], results[0].finest);
  let waiting = 0;
  const redraw = () => {
    waiting ||= requestAnimationFrame(draw);
  };
  // What has changed: before is to the left of the divider.
  const change = results.length > 1 && results[0].change;
  const panes = (change ? [1, 0] : [0, 1]).map((i) => new Pane(renderer, maps, results, i, redraw));
  const state = { layout: change ? "divider" : results.length > 1 ? "side" : "one", divider: 0.5, drags: "light", held: null };
  const areas = () => boxes(state.layout, state.divider, canvas);
  const draw = () => {
    waiting = 0;
    renderer.clear();
    const drawn = areas();
    drawn.forEach((box, i) => panes[i].draw({ box, view: { x: place.x + box.x, y: place.y + box.y, zoom: place.zoom }, light, look }));
    canvas.dataset.drawn = String(Number(canvas.dataset.drawn ?? 0) + 1);
    canvas.dataset.pending = String(panes[0].tiles.pending + panes[1].tiles.pending);
    zoomed.textContent = `${((100 * place.zoom) / place.unit).toFixed(0)} %`;
    const images = panes.slice(0, drawn.length).map((pane) => pane.captured(light)).find((one) => one.length > 0) ?? [];
    status.textContent = [`Light: ${light.text}`, ...images.map(([image, share]) => `image ${image.name} ${(100 * share).toFixed(0)} %`)].join(", ");
  };
  light.listeners.push(redraw);

  // The stage: canvas, divider, and the names of the pictures.
  const divider = element("div", { class: "divider", role: "slider", tabindex: 0, hidden: true, "aria-label": "Divider of the two pictures", "aria-valuemin": 0, "aria-valuemax": 100 });
  const setDivider = (share) => {
    state.divider = Math.min(1, Math.max(0, share));
    divider.style.left = `${100 * state.divider}%`;
    divider.setAttribute("aria-valuenow", Math.round(100 * state.divider));
    redraw();
  };
  divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId)) return;
    const box = canvas.getBoundingClientRect();
    setDivider((event.clientX - box.left) / box.width);
  });
  divider.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
    if (!step) return;
    event.preventDefault();
    setDivider(state.divider + step);
  });
  const names = panes.map(() => element("div", { class: "name", hidden: true }));
  const stage = element("div", { class: "stage" }, canvas, ...names, divider);
  const arrange = () => {
    const drawn = areas();
    place.reframe(state.layout === "side" ? drawn[0] : canvas);
    divider.hidden = state.layout !== "divider";
    pickers[1].row.hidden = drawn.length < 2;
    names.forEach((name, i) => {
      const { left, top, width } = drawn[i] ?? { left: 0, top: 0, width: 0 };
      // With the divider, the second name is at the right edge.
      const right = state.layout === "divider" && i === 1;
      Object.assign(name.style, right ? { right: "0", left: "auto" } : { left: `${(100 * left) / canvas.width}%`, right: "auto" });
      Object.assign(name.style, { top: `${(100 * top) / canvas.height}%`, maxWidth: `${(state.layout === "divider" ? 50 : (100 * width) / canvas.width)}%` });
      name.hidden = drawn.length < 2;
    });
    showLegends();
    redraw();
  };

  const inFrame = (x, y, box = boxAt(areas(), x, y)) => [x - box.x, y - box.y];
  gestures(canvas, {
    pans: (event) => state.drags === "picture" || event.shiftKey || event.buttons === 4 || event.buttons === 2,
    drag: (x, y, start) => {
      if (start) state.held = boxAt(areas(), x, y);
      const [right, down] = inFrame(x, y, state.held);
      light.turnTo((2 * right) / place.frame.width - 1, 1 - (2 * down) / place.frame.height);
    },
    pan: (x, y) => (place.pan(x, y), redraw()),
    zoom: (factor, x, y) => (place.zoomTo(place.zoom * factor, ...inFrame(x, y)), redraw()),
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("keydown", (event) => {
    const pans = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
    const zooms = { "+": 1.25, "=": 1.25, "-": 0.8 };
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.shiftKey && event.key in pans) place.pan(...pans[event.key]);
    else if (event.key in zooms) place.zoomTo(place.zoom * zooms[event.key]);
    else if (event.key === "0") place.fit();
    else if (event.key === "1") place.zoomTo(place.unit);
    else if (!turnByKey(light, event.key)) return;
    event.preventDefault();
    redraw();
  });

  // The controls.
  const zoomed = element("output", { class: "zoomed" });
  const button = (text, onclick, title) => element("button", { type: "button", onclick, title: title ?? null }, text);
  const zoomBar = element(
    "div",
    { class: "bar", role: "group", "aria-label": "Zoom" },
    button("−", () => (place.zoomTo(place.zoom / 1.25), redraw()), "Zoom out"),
    button("+", () => (place.zoomTo(place.zoom * 1.25), redraw()), "Zoom in"),
    button("Fit", () => (place.fit(), redraw()), "Show the complete picture"),
    button("1:1", () => (place.zoomTo(place.unit), redraw()), "One pixel of the screen for each embedded pixel"),
    zoomed,
  );
  const drags = selection("Dragging", [["light", "turns the light"], ["picture", "moves the picture"]], "light", (value) => (state.drags = value));

  const legends = panes.map(() => element("div", { class: "legend" }));
  const showLegends = () => {
    const count = areas().length;
    panes.forEach((pane, i) => {
      const found = i < count && pane.legend();
      const which = count > 1 ? `${i === 0 ? "First" : "Second"} picture: ` : "";
      legends[i].replaceChildren(...(found ? [scale(found.samples, found.low, found.high, which + found.title)] : []));
      const mode = modesOf(pane.result).find(([key]) => key === pane.mode)?.[1] ?? "";
      names[i].textContent = results.length > 1 ? `${pane.result.name} \u2013 ${mode}` : mode;
    });
  };
  const pickers = panes.map((pane, i) => picker(pane, i, results, async () => {
    await pane.prepare(look);
    canvas.dataset.shown = panes.map((one) => one.shown?.mode ?? "").join(" ");
    showLegends();
    redraw();
  }));
  const layout = selection("Layout", LAYOUTS, state.layout, (value) => {
    state.layout = value;
    remember("layout", value);
    arrange();
  });
  const marks = element("input", { type: "checkbox" });
  marks.checked = look.marked;
  marks.addEventListener("change", () => {
    look.marked = marks.checked;
    redraw();
  });
  const markable = { invented: "mark invented pixels", significant: "outline significant changes" };
  const [, text] = Object.entries(markable).find(([name]) => results.some((one) => one.has(name))) ?? [];
  const marked = element("label", { class: "check", hidden: !text }, marks, text ?? "");

  const near = element("input", { type: "checkbox" });
  const distance = slider("Distance", { min: 0.2, max: 3, step: 0.05, value: 1, shown: (v) => `${v.toFixed(2)} ×`, onchange: (v) => light.set({ distance: v }) });
  distance.input.disabled = true;
  near.addEventListener("change", () => {
    distance.input.disabled = !near.checked;
    light.set({ near: near.checked });
  });
  const turning = animation(light);
  const lightBox = element(
    "fieldset",
    {},
    element("legend", {}, "Light"),
    element(
      "div",
      { class: "aiming" },
      dome(light, results[0].lights.map((one) => one.direction)),
      element(
        "div",
        { class: "presets" },
        button("Raking", () => light.set({ elevation: RAKING_DEG }), "Light from the side"),
        button("Overhead", () => light.set({ elevation: 90 })),
        turning.button,
        element("label", { class: "check" }, near, "near light"),
      ),
    ),
    distance.row,
    slider("Brightness", { min: 0.2, max: 4, step: 0.05, value: 1, shown: (v) => `${v.toFixed(2)} ×`, onchange: (v) => ((look.gain = v), redraw()) }).row,
  );
  const smooth = later(async (value) => {
    look.smoothing = value;
    for (const pane of panes) await pane.prepare(look);
    showLegends();
    redraw();
  });
  const surfaceBox = element(
    "fieldset",
    {},
    element("legend", {}, "Surface"),
    slider(results[0].has("shape") ? "Detail" : "Slopes", { min: 0, max: 8, step: 0.1, value: 1, shown: (v) => `${v.toFixed(1)} ×`, onchange: (v) => ((look.exaggeration = v), redraw()) }).row,
    slider("Smoothing", { min: 0, max: 10, step: 0.5, value: 0, shown: (v) => `${v.toFixed(1)} px`, onchange: smooth }).row,
    slider("Gloss", { min: 0, max: 1, step: 0.05, value: look.gloss, shown: (v) => v.toFixed(2), onchange: (v) => ((look.gloss = v), redraw()) }).row,
  );
  const viewBox = element(
    "fieldset",
    {},
    element("legend", {}, "View"),
    layout.row,
    pickers[0].row,
    pickers[1].row,
    marked,
    drags.row,
  );
  const status = element("p", { class: "caption status" });
  const note = element("p", { class: "caption" }, "Shading of the embedded maps: cast shadows and reflections are not shown.");
  body.append(element("div", { class: "relight" }, element("div", { class: "picture" }, stage, element("div", { class: "below" }, status, zoomBar), element("div", { class: "legends" }, ...legends), note), element("div", { class: "controls" }, viewBox, lightBox, surfaceBox)));
  document.getElementById("prerendered")?.classList.add("replaced");

  new ResizeObserver(() => {
    const ratio = window.devicePixelRatio || 1;
    const box = canvas.getBoundingClientRect();
    const [width, height] = [Math.max(1, Math.round(box.width * ratio)), Math.max(1, Math.round(box.height * ratio))];
    if (canvas.width === width && canvas.height === height) return;
    canvas.width = width;
    canvas.height = height;
    arrange();
    draw();
  }).observe(canvas);
  // The address of the event: the page's own may have been written again since then.
  const recall = (event) => {
    const wish = (key) => remembered(key, event?.newURL);
    const [azimuth, elevation] = (wish("light") ?? "").split(",").map(Number);
    if (Number.isFinite(azimuth) && Number.isFinite(elevation)) light.set({ azimuth, elevation: Math.min(90, Math.max(1, elevation)) });
    panes.forEach((pane, i) => pickers[i].choose(wish(i === 0 ? "show" : "right")));
    const wanted = wish("layout");
    if (LAYOUTS.some(([key]) => key === wanted)) state.layout = layout.input.value = wanted;
    arrange();
    if (wish("zoom") === "1") {
      place.fit();
      place.zoomTo(place.unit);
    }
    redraw();
  };
  window.addEventListener("hashchange", recall);
  const keep = later(() => remember("light", `${light.azimuth.toFixed(1)},${light.elevation.toFixed(1)}`), 500);
  setDivider(0.5);
  recall();
  light.listeners.push(keep);
  return { hide: turning.stop };
}
