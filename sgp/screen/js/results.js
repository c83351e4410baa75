// What tasks found: questions, checks, metering, the recording with its frames, normals.

import { element } from "./elements.js";
import { ask } from "./link.js";

/** Fill the box of questions; returns a function that shows a state. */
export function questionBox(box) {
  let shown = null;
  return ({ question, controls }) => {
    box.hidden = !question;
    if (!question) return;
    if (question.id !== shown) {
      shown = question.id;
      const button = (text, yes) =>
        element("button", { type: "button", onclick: () => ask({ do: "answer", question: question.id, yes }) }, text);
      box.replaceChildren(
        element("p", {}, question.text),
        element("div", { class: "bar" }, button("Continue", true), button("Stop", false)),
      );
      box.focus(); // not a button: a key that was meant for something else must not answer
    }
    for (const button of box.querySelectorAll("button")) button.disabled = !controls;
  };
}

/** Fill the results; returns a function that shows a state. */
export function results(box) {
  let shown = "";
  return ({ checks, metered, notices, recording, look }) => {
    const { frames, ...rest } = recording ?? {};
    const key = JSON.stringify([checks, metered, notices, rest, look]);
    if (key === shown) return;
    shown = key;
    box.replaceChildren(
      ...(recording ? recorded(rest) : []),
      ...(look ? normals(look) : []),
      ...(checks ? [element("h2", {}, "Checks"), list(checks.flatMap(findings))] : []),
      ...(metered ? [element("h2", {}, "Metering"), list(notices), details(metered)] : []),
    );
  };
}

function recorded({ folder, state, verdict, lines }) {
  return [
    element("h2", {}, `Recording ${folder}: ${state}`),
    ...(verdict ? [element("p", {}, verdict)] : []),
    list(lines),
  ];
}

function normals({ verdict, folder }) {
  return [
    element("h2", {}, "Normals at reduced size"),
    element("p", {}, verdict),
    element("img", { class: "look", src: picture("look", folder), alt: "Normals: red is right, green is up, blue is toward the camera" }),
  ];
}

/** Return the address of a picture; browsers keep the picture of an address that they know. */
function picture(name, folder) {
  return `picture?${new URLSearchParams({ name, folder })}`;
}

const SEVERITIES = { ok: "note", warning: "warning", failed: "error", "not done": "note" };

function findings({ name, state, lines }) {
  return lines.map((text) => ({ severity: SEVERITIES[state], text: `${name}, ${state}: ${text}` }));
}

function list(lines) {
  const items = lines.map(({ severity, text }) => element("li", { class: severity }, text));
  return element("ul", { class: "notices" }, ...items);
}

function details(lights) {
  return element("details", {}, element("summary", {}, metering(lights)), table(lights));
}

function metering(lights) {
  const times = lights.map(({ exposure_us }) => exposure_us / 1000);
  const bad = lights.filter(({ state }) => state !== "ok").length;
  const range = `${Math.min(...times).toPrecision(3)} to ${Math.max(...times).toPrecision(3)} ms`;
  return `${lights.length} LEDs, ${range}${bad ? `, ${bad} not ok` : ""}`;
}

function table(lights) {
  const cells = ({ led, exposure_us, level, state }) => [led, (exposure_us / 1000).toPrecision(4), `${(100 * level).toFixed(0)} %`, state];
  const row = (kind, values) => element("tr", {}, ...values.map((value) => element(kind, {}, String(value))));
  return element(
    "div",
    { class: "scroll" },
    element(
      "table",
      {},
      element("thead", {}, row("th", ["LED", "exposure, ms", "level", "state"])),
      element("tbody", {}, ...lights.map((light) => row("td", cells(light)))),
    ),
  );
}

/** Show a thumbnail of each frame as it arrives; returns a function that shows a state. */
export function thumbnails(box) {
  let folder = null;
  let count = 0;
  return ({ recording }) => {
    if (recording?.folder !== folder) {
      folder = recording?.folder ?? null;
      count = 0;
      box.replaceChildren();
    }
    for (const { file } of (recording?.frames ?? []).slice(count)) {
      const image = element("img", { src: picture(file, folder), alt: file, width: 96 });
      box.append(element("figure", {}, image, element("figcaption", {}, file)));
      count++;
    }
  };
}
