// The relightable view: one or two panes of a canvas under one light.

import { remember, remembered } from "../js/address.js";
import { colourMap, scale } from "../js/colours.js";
import { element, selection, slider } from "../js/elements.js";
import { Place, gestures } from "../js/gestures.js";
import { Light, RAKING_DEG, dome, turnByKey } from "../js/light.js";
import { modesOf } from "../js/modes.js";
import { Pane } from "../js/pane.js";
import { Renderer } from "../js/renderer.js";

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
  const look = { exaggeration: 1, smoothing: 0, gain: 1, gloss: 0.5, shine: 30 };
  const place = new Place(canvas, results[0]);
  const panes = [new Pane(renderer, maps, results, 0), new Pane(renderer, maps, results, 1)];
  const state = { compare: false, divider: 0.5, drags: "light" };

  let waiting = 0;
  const redraw = () => {
    waiting ||= requestAnimationFrame(draw);
  };
  const draw = () => {
    waiting = 0;
    renderer.clear();
    const { width } = canvas;
    const middle = state.compare ? Math.round(state.divider * width) : width;
    panes[0].draw({ left: 0, right: middle, view: place, light, look });
    if (state.compare) panes[1].draw({ left: middle, right: width, view: place, light, look });
    canvas.dataset.drawn = String(Number(canvas.dataset.drawn ?? 0) + 1);
    zoomed.textContent = `${(100 * place.zoom).toFixed(0)} %`;
    const images = panes[0].captured(light).map(([image, share]) => `${image.name} ${(100 * share).toFixed(0)} %`);
    status.textContent = images.length > 0 ? `Images ${images.join(", ")}` : `Light: ${light.text}`;
  };
  light.listeners.push(redraw);

  // The stage: canvas, divider and what lies on them.
  const divider = element("div", { class: "divider", role: "slider", tabindex: 0, hidden: true, "aria-label": "Divider of the two views", "aria-valuemin": 0, "aria-valuemax": 100 });
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
  const stage = element("div", { class: "stage" }, canvas, divider);

  gestures(canvas, {
    pans: (event) => state.drags === "picture" || event.shiftKey || event.buttons === 4 || event.buttons === 2,
    drag: (x, y) => light.turnTo((2 * x) / canvas.width - 1, 1 - (2 * y) / canvas.height),
    pan: (x, y) => (place.pan(x, y), redraw()),
    zoom: (factor, x, y) => (place.zoomTo(place.zoom * factor, x, y), redraw()),
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("keydown", (event) => {
    const pans = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
    const zooms = { "+": 1.25, "=": 1.25, "-": 0.8 };
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.shiftKey && event.key in pans) place.pan(...pans[event.key]);
    else if (event.key in zooms) place.zoomTo(place.zoom * zooms[event.key]);
    else if (event.key === "0") place.fit();
    else if (event.key === "1") place.zoomTo(1);
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
    button("1:1", () => (place.zoomTo(1), redraw()), "One pixel of the screen for each embedded pixel"),
    zoomed,
  );
  const drags = selection("Dragging moves", [["light", "the light"], ["picture", "the picture"]], "light", (value) => (state.drags = value));

  const legends = panes.map(() => element("div", { class: "legend" }));
  const showLegends = () =>
    panes.forEach((pane, i) => {
      const found = (i === 0 || state.compare) && pane.legend();
      legends[i].replaceChildren(...(found ? [scale(found.samples, found.low, found.high, found.title)] : []));
    });
  const pickers = panes.map((pane, i) => picker(pane, i, results, async () => {
    await pane.prepare(look);
    canvas.dataset.shown = panes.map((one) => one.shown?.mode ?? "").join(" ");
    showLegends();
    redraw();
  }));
  pickers[1].row.hidden = true;
  const compare = element("input", { type: "checkbox" });
  compare.addEventListener("change", () => {
    state.compare = compare.checked;
    divider.hidden = pickers[1].row.hidden = !compare.checked;
    setDivider(0.5);
    showLegends();
  });

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
    dome(light, results[0].lights.map((one) => one.direction)),
    element("div", { class: "bar" }, button("Raking", () => light.set({ elevation: RAKING_DEG }), "Light from the side"), button("Overhead", () => light.set({ elevation: 90 })), turning.button),
    element("label", { class: "check" }, near, "near light"),
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
    pickers[0].row,
    element("label", { class: "check" }, compare, "compare, with a divider"),
    pickers[1].row,
    drags.row,
    zoomBar,
  );
  const status = element("p", { class: "caption status" });
  const note = element("p", { class: "caption" }, "Shading of the embedded maps: cast shadows and reflections are not shown.");
  body.append(element("div", { class: "relight" }, element("div", { class: "picture" }, stage, status, element("div", { class: "legends" }, ...legends), note), element("div", { class: "controls" }, viewBox, lightBox, surfaceBox)));
  document.getElementById("prerendered")?.classList.add("replaced");

  new ResizeObserver(() => {
    const ratio = window.devicePixelRatio || 1;
    const box = canvas.getBoundingClientRect();
    const [width, height] = [Math.max(1, Math.round(box.width * ratio)), Math.max(1, Math.round(box.height * ratio))];
    if (canvas.width === width && canvas.height === height) return;
    canvas.width = width;
    canvas.height = height;
    if (place.fitted) place.fit();
    draw();
  }).observe(canvas);
  const recall = () => {
    const [azimuth, elevation] = (remembered("light") ?? "").split(",").map(Number);
    if (Number.isFinite(azimuth) && Number.isFinite(elevation)) light.set({ azimuth, elevation: Math.min(90, Math.max(1, elevation)) });
    panes.forEach((pane, i) => pickers[i].choose(remembered(i === 0 ? "show" : "right")));
    if (remembered("zoom") === "1") place.zoomTo(1);
    redraw();
  };
  window.addEventListener("hashchange", recall);
  const keep = later(() => remember("light", `${light.azimuth.toFixed(1)},${light.elevation.toFixed(1)}`), 500);
  recall();
  light.listeners.push(keep);
  setDivider(0.5);
  return { hide: turning.stop };
}

/** Return the selection of a pane: the result, if there are several, and the mode. */
function picker(pane, index, results, changed) {
  const side = index === 0 ? "Show" : "Right of it";
  const modes = element("div");
  const fill = () => {
    const offered = modesOf(pane.result);
    const known = offered.some(([key]) => key === pane.mode);
    if (!known) pane.mode = offered[Math.min(index, offered.length - 1)][0];
    const made = selection(side, offered, pane.mode, (value) => {
      pane.mode = value;
      remember(index === 0 ? "show" : "right", value);
      changed();
    });
    modes.replaceChildren(made.row);
  };
  const choose = (mode) => {
    if (modesOf(pane.result).some(([key]) => key === mode)) pane.mode = mode;
    fill();
    changed();
  };
  const rows = [modes];
  if (results.length > 1) {
    const names = results.map((result, i) => [String(i), result.name]);
    rows.unshift(
      selection("Result", names, String(results.indexOf(pane.result)), (value) => {
        pane.result = results[Number(value)];
        fill();
        changed();
      }).row,
    );
  }
  fill();
  return { row: element("div", { class: "picker" }, ...rows), choose };
}

/** Return a button that lets the light circle. */
function animation(light) {
  let frame = 0;
  let before = 0;
  const step = (now) => {
    light.turn(Math.min(100, now - before) * 0.06, 0);
    before = now;
    frame = requestAnimationFrame(step);
  };
  const stop = () => {
    cancelAnimationFrame(frame);
    frame = 0;
    button.setAttribute("aria-pressed", "false");
  };
  const button = element("button", { type: "button", "aria-pressed": "false" }, "Circle");
  button.addEventListener("click", () => {
    if (frame) return stop();
    before = performance.now();
    frame = requestAnimationFrame(step);
    button.setAttribute("aria-pressed", "true");
  });
  return { button, stop };
}

/** Return a function that waits until its value stands still. */
function later(action, milliseconds = 120) {
  let timer = 0;
  return (value) => {
    clearTimeout(timer);
    timer = setTimeout(() => action(value), milliseconds);
  };
}
