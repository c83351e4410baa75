// Needs: three
// The surface in 3D: turned by hand, cut, and measured.

import { remember, remembered } from "../js/address.js";
import { scale } from "../js/colours.js";
import { element, selection, slider } from "../js/elements.js";
import { Light, dome } from "../js/light.js";
import { Heights } from "../js/surface/heights.js";
import { Marks } from "../js/surface/marks.js";
import { meshOf } from "../js/surface/mesh.js";
import { overlay } from "../js/surface/overlay.js";
import { panel } from "../js/surface/panel.js";
import { MOST_EXAGGERATION, Scene } from "../js/surface/scene.js";
import { texture, texturesOf } from "../js/surface/textures.js";

export const label = "3D";

const MOST_VERTICES = 1e6;
const CLICK_PX = 5;
const MOST_PLOT_PX = 900;

export async function mount(body, { results, report }) {
  const usable = results.filter((result) => result.has("height"));
  if (usable.length === 0) {
    body.append(element("p", {}, "This result has no height map; sgp surface computes one."));
    return null;
  }
  const canvas = element("canvas", {
    tabindex: 0,
    role: "img",
    class: "surface",
    "aria-label": "The surface in 3D. Arrow keys turn it, with Shift they move it, + and - zoom, 0 shows it tilted, 1 from the front, 2 from the side",
  });
  const over = overlay();
  const stage = element("div", { class: "stage" }, canvas, over.body);
  const light = new Light();
  const state = { heights: null, data: null, texture: null };
  const scene = new Scene(canvas, () => {
    over.draw(scene, state.heights, measuring.shown());
    canvas.dataset.drawn = String(Number(canvas.dataset.drawn ?? 0) + 1);
  });
  const measuring = panel(() => scene.redraw());
  light.listeners.push(() => scene.light(light.direction));

  const legend = element("div", { class: "legend" });
  const textures = element("div");
  const cutting = element("div");
  const stated = element("p", { class: "caption" });
  const dress = async (name) => {
    state.texture = name;
    const made = await texture(name, state.data, report.colourMaps);
    scene.cover(made.picture);
    legend.replaceChildren(...(made.scale ? [scale(made.scale.samples, made.scale.low, made.scale.high, made.scale.title)] : []));
    canvas.dataset.texture = name;
  };
  const open = async (result) => {
    const data = { ...(await result.data()), camera: result.camera, roughness: result.roughness, result };
    state.data = data;
    state.heights = new Heights(data, result.heightDifferences ?? null);
    const mesh = meshOf(state.heights, MOST_VERTICES);
    scene.open(mesh, state.heights);
    scene.clip(null);
    measuring.open(state.heights, new Marks(`marks-${result.id}`), result.name);
    const offered = texturesOf(data);
    const chosen = offered.some(([name]) => name === state.texture) ? state.texture : offered[0][0];
    textures.replaceChildren(selection("Texture", offered, chosen, dress).row);
    cutting.replaceChildren(...sectionControls(scene, state.heights, mesh.range));
    stated.textContent = statement(data, mesh, state.heights);
    await dress(chosen);
  };

  let pressed = null;
  const at = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  canvas.addEventListener("pointerdown", (event) => (pressed = event.isPrimary && event.button === 0 ? at(event) : null));
  canvas.addEventListener("pointerup", (event) => {
    if (pressed === null) return;
    const [left, top] = at(event);
    if (Math.hypot(left - pressed[0], top - pressed[1]) < CLICK_PX) measuring.click(scene.hit(left, top));
    pressed = null;
  });
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !scene.key(event)) return;
    event.preventDefault();
  });
  body.addEventListener("keydown", (event) => event.key === "Escape" && measuring.cancel());

  const button = (text, onclick, title = null) => element("button", { type: "button", onclick, title }, text);
  const looks = { tilted: "Tilted", front: "Front", side: "Side" };
  const names = usable.map((result, i) => [String(i), result.name]);
  const viewBox = element(
    "fieldset",
    {},
    element("legend", {}, "View"),
    ...(usable.length > 1 ? [selection("Result", names, "0", (i) => open(usable[Number(i)])).row] : []),
    element("div", { class: "bar", role: "group", "aria-label": "Direction and zoom" }, ...Object.entries(looks).map(([name, text]) => button(text, () => scene.look(name))), button("−", () => scene.zoom(0.8), "Zoom out"), button("+", () => scene.zoom(1.25), "Zoom in")),
    slider("Heights", { min: 0, max: MOST_EXAGGERATION, step: 0.1, value: 1, shown: (v) => `${v.toFixed(1)} ×`, onchange: (v) => scene.exaggerate(v) }).row,
    textures,
    cutting,
  );
  const lightBox = element("fieldset", {}, element("legend", {}, "Light"), dome(light, usable[0].lights.map((one) => one.direction)));
  const help = element("p", { class: "caption" }, "Drag to turn, with the right button or two fingers to move; the wheel or two fingers zoom.");
  body.append(
    element("div", { class: "relight" }, element("div", { class: "picture" }, stage, help, legend), element("div", { class: "controls" }, viewBox, measuring.controls, lightBox)),
    measuring.list,
    stated,
  );
  await open(usable[0]);
  new ResizeObserver(() => {
    const { width, height } = canvas.getBoundingClientRect();
    if (width === 0 || height === 0) return;
    measuring.resize(Math.round(Math.min(MOST_PLOT_PX, measuring.list.clientWidth)));
    scene.resize(width, height);
  }).observe(stage);
  window.addEventListener("hashchange", measuring.recall);
  const follow = () => {
    const [azimuth, elevation] = (remembered("light") ?? "").split(",").map(Number);
    if (Number.isFinite(azimuth) && Number.isFinite(elevation)) light.set({ azimuth, elevation: Math.min(90, Math.max(1, elevation)) });
    else light.changed();
  };
  const hand = () => {
    remember("light", `${light.azimuth.toFixed(1)},${light.elevation.toFixed(1)}`);
    window.dispatchEvent(new Event("hashchange"));
  };
  return { show: follow, hide: hand };
}

/** Return the selection of a section plane and the slider that moves it. */
function sectionControls(scene, heights, range) {
  const limits = [[-heights.half[0], heights.half[0]], [-heights.half[1], heights.half[1]], range];
  const place = element("div");
  const choose = (key) => {
    if (key === "none") {
      place.replaceChildren();
      return scene.clip(null);
    }
    const axis = Number(key);
    const [min, max] = limits[axis];
    const digits = Math.max(0, 3 - Math.ceil(Math.log10(max - min || 1)));
    const value = (min + max) / 2;
    place.replaceChildren(
      slider("Position", { min, max, step: "any", value, shown: (v) => v.toFixed(digits).replace("-", "\u2212"), onchange: (v) => scene.clip({ axis, value: v }) }).row,
    );
    return scene.clip({ axis, value });
  };
  const options = [["none", "none"], ["0", "across x"], ["1", "across y"], ["2", "level"]];
  return [selection(`Section, ${heights.unit}`, options, "none", choose).row, place];
}

/** Say whether figures follow the lines of sight. */
function perspective({ camera, unit }) {
  if (camera) return ` Figures and the picture follow the lines of sight of the camera, which is ${Number(camera.distance.toPrecision(4))} ${unit} above height 0; x and y of places are those at height 0.`;
  return " The lines of sight count as parallel: under a camera close to the object, what is nearer by 1 % of the distance is measured 1 % too long and wide.";
}

/** Say what the figures and the picture are made of. */
function statement(data, mesh, heights) {
  const reduced = mesh.step > 1 ? ` The picture shows every ${mesh.step}th pixel of a row and a column; figures use all.` : "";
  const full = data.result.reduction > 1 ? ` They are averages over ${data.result.reduction.toFixed(1)} x ${data.result.reduction.toFixed(1)} pixels of the result.` : "";
  let errors = "";
  if (heights.differences) errors = " Deviations of height differences are those of the record at this distance; common errors of the normals are not in them.";
  else if (heights.sigma) errors = " Deviations of height differences take the errors of both heights as independent.";
  return `Figures use the embedded heights (${data.columns} x ${data.rows} pixels, steps of ${data.heightStep.toPrecision(2)} ${data.unit}), interpolated, without the exaggeration.${full}${perspective(heights)}${reduced}${errors} The scale bar holds everywhere.`;
}
