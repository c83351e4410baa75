// The controls that set marks, and the list of marks with their figures.

import { element } from "../elements.js";
import { described, forFile } from "./figures.js";
import { MOST_LETTERS } from "./marks.js";
import { measured, profile } from "./measure.js";
import { profilePlot, profileTable } from "./plot.js";
import { corners } from "./roughness.js";

const KINDS = {
  point: { label: "Point", least: 1, most: 1, hint: "Click a place on the surface, or type it." },
  distance: { label: "Distance", least: 2, most: 2, hint: "Click two places on the surface, or type them." },
  rectangle: { label: "Rectangle", least: 2, most: 2, hint: "Click two opposite corners on the surface, or type them." },
  area: { label: "Area", least: 3, most: Infinity, hint: "Click the corners of a polygon, or type them; then press Done." },
};

/** Return controls, the list, and what the view calls; `changed` is called to draw. */
export function panel(changed) {
  const state = { heights: null, marks: null, name: "", kind: null, points: [], selected: 0, width: 720 };
  const hint = element("p", { class: "caption hint", role: "status" });
  const number = (name) => element("input", { type: "number", step: "any", "aria-label": name, disabled: true });
  const [x, y] = [number("x of the point"), number("y of the point")];
  const button = (text, onclick) => element("button", { type: "button", onclick }, text);
  const [set, done] = [button("Set", () => add([x.valueAsNumber, y.valueAsNumber])), button("Done", finish)];
  const tools = Object.entries(KINDS).map(([kind, { label }]) => {
    const tool = button(label, () => start(state.kind === kind ? null : kind));
    tool.dataset.kind = kind;
    return tool;
  });
  for (const input of [x, y]) input.addEventListener("keydown", (event) => event.key === "Enter" && set.click());
  const file = element("input", { type: "file", accept: ".json,application/json", hidden: true });
  file.addEventListener("change", load);
  const controls = element(
    "fieldset",
    { class: "measure" },
    element("legend", {}, "Measure"),
    element("div", { class: "bar", role: "group", "aria-label": "What to measure" }, ...tools),
    hint,
    element("div", { class: "typed" }, element("span", {}, "x"), x, element("span", {}, "y"), y, set, done),
    element("div", { class: "bar" }, button("Save annotations", save), button("Load annotations", () => file.click()), file),
  );
  const list = element("div", { class: "marks" });

  function start(kind) {
    state.kind = kind;
    state.points = [];
    refresh();
  }

  function refresh(message = null) {
    for (const tool of tools) tool.setAttribute("aria-pressed", String(tool.dataset.kind === state.kind));
    for (const one of [x, y, set]) one.disabled = state.kind === null;
    done.hidden = state.kind !== "area";
    done.disabled = state.points.length < 3;
    const unit = state.heights?.unit;
    const idle = `Places have x to the right and y up from the middle, in ${unit}.`;
    hint.textContent = message ?? (state.kind ? `${KINDS[state.kind].hint} ${state.points.length ? `Points: ${state.points.length}.` : ""}` : idle);
    changed();
  }

  function add(place) {
    const { heights, kind } = state;
    const [u, v] = heights.rounded(place);
    if (Number.isNaN(heights.at(u, v))) {
      return refresh(Number.isFinite(u + v) ? `There is no surface at x ${u}, y ${v}.` : "Type numbers for x and y.");
    }
    state.points.push([u, v]);
    if (state.points.length >= KINDS[kind].most) return finish();
    return refresh();
  }

  function finish() {
    const { kind } = state;
    if (state.points.length < KINDS[kind].least) return;
    const points = kind === "rectangle" ? corners(state.heights, state.points) : state.points;
    state.points = [];
    if (kind === "rectangle" && (points[0][0] === points[2][0] || points[0][1] === points[2][1])) {
      refresh("Both corners are in one row or column of pixels.");
      return;
    }
    guarded(() => (state.selected = state.marks.add(points)));
  }

  /** Do what changes marks; what is wrong is said. */
  function guarded(action, subject = "The list") {
    let message = null;
    try {
      action();
    } catch (error) {
      message = `${subject} ${error.message}.`;
    }
    fill();
    refresh(message);
  }

  function fill() {
    const { marks, heights } = state;
    state.selected = Math.min(state.selected, marks.list.length - 1);
    list.replaceChildren(...marks.list.map((mark, i) => row(mark, i, measured(heights, mark.points))));
  }

  function row(mark, i, found) {
    const text = element("input", { type: "text", value: mark.text, maxlength: MOST_LETTERS, placeholder: "Text", "aria-label": `Text of ${KINDS[found.kind].label.toLowerCase()} ${i + 1}` });
    text.addEventListener("input", () => {
      marks().describe(i, text.value);
      changed();
    });
    const remove = button("Delete", () => guarded(() => marks().remove(i)));
    const select = button(`${i + 1}. ${KINDS[found.kind].label}`, () => {
      state.selected = i;
      fill();
      changed();
      list.querySelectorAll(".select")[i].focus();
    });
    select.className = "select";
    select.setAttribute("aria-pressed", String(i === state.selected));
    const figures = described(found, state.heights.unit).flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)]);
    const body = element("section", { class: "mark" }, element("div", { class: "bar" }, select, text, remove), element("dl", {}, ...figures));
    if (found.kind === "distance" && i === state.selected) body.append(...profileOf(mark.points));
    return body;
  }

  function profileOf(points) {
    const samples = profile(state.heights, ...points);
    const { unit, sigma } = state.heights;
    const caption = sigma
      ? "Band: one standard deviation of the height, up and down."
      : "No error band: this result has no standard deviations of heights (sgp surface --height-sigma).";
    return [
      profilePlot(samples, unit, state.width),
      element("p", { class: "caption" }, caption),
      button("Save profile", () => download(profileTable(samples, unit), `${state.name}-profile.csv`, "text/csv")),
    ];
  }

  const marks = () => state.marks;

  function save() {
    const figures = marks().list.map((mark) => forFile(measured(state.heights, mark.points)));
    download(marks().written(state.name, state.heights.unit, figures), `${state.name}-annotations.json`, "application/json");
  }

  async function load() {
    const [chosen] = file.files;
    if (!chosen) return;
    const text = await chosen.text();
    file.value = "";
    guarded(() => marks().read(text, state.heights.unit), chosen.name);
  }

  return {
    controls,
    list,
    click: (place) => state.kind !== null && (place ? add(place) : refresh("There is no surface at this place.")),
    cancel: () => start(null),
    recall: () => state.marks.recall() && guarded(() => {}),
    open(heights, found, name) {
      Object.assign(state, { heights, marks: found, name, selected: 0 });
      fill();
      start(null);
    },
    resize(width) {
      if (width === state.width) return;
      state.width = width;
      fill();
    },
    shown() {
      const set = state.marks.list.map(({ points, text }, i) => ({ points, label: text ? `${i + 1} ${text}` : String(i + 1), selected: i === state.selected }));
      return state.points.length > 0 ? [...set, { points: state.points, label: "", open: true, selected: true }] : set;
    },
  };
}

function download(text, name, type) {
  const url = URL.createObjectURL(new Blob([text], { type }));
  element("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
