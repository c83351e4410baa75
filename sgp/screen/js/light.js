// Which LEDs light the live picture, and how long the camera exposes.

import { element, selection } from "./elements.js";
import { ask } from "./link.js";

const MODES = [
  ["one", "one LED"],
  ["cycle", "LEDs in turn"],
  ["all", "mean of LEDs"],
];

/** Fill the panel; returns a function that shows a state. */
export function lightPanel(panel, makeDome) {
  let state = null;
  const said = element("p", { class: "said error", role: "alert" });
  const send = async (change) => {
    const { mode, leds, exposure_us, gain_db } = { ...state.live, ...change };
    said.textContent = await ask({ do: "light", mode, leds, exposure_us, gain_db });
  };
  const dome = makeDome((led, more) => {
    if (panel.disabled) return;
    const { leds, mode } = state.live;
    if (mode === "one" && !more) return send({ leds: [led] });
    const others = leds.filter((one) => one !== led);
    send({ mode: mode === "one" ? "cycle" : mode, leds: others.length < leds.length ? others : [...leds, led] });
  });
  const modes = selection("Show", MODES, "one", (mode) => {
    const alive = [...Array(state.rig.leds).keys()].filter((led) => !state.rig.dead_leds.includes(led));
    const { leds } = state.live;
    send({ mode, leds: mode === "one" ? leds.slice(0, 1) : leds.length > 1 ? leds : alive });
  });
  const number = (label, name, attributes, scale) => {
    const input = element("input", { type: "number", ...attributes });
    input.addEventListener("change", () => send({ [name]: input.valueAsNumber * scale }));
    return { row: element("label", { class: "field" }, element("span", {}, label), input), input, name, scale };
  };
  const numbers = [
    number("Exposure, ms", "exposure_us", { min: 0.001, step: "any" }, 1000),
    number("Gain, dB", "gain_db", { min: 0, step: "any" }, 1),
  ];
  const off = element("button", { type: "button", onclick: () => send({ mode: "one", leds: [] }) }, "LEDs off");
  const pause = element("button", { type: "button", onclick: () => ask({ do: "pause", paused: !state.live.paused }) }, "Pause");
  const settings = element("div", {}, modes.row, ...numbers.map(({ row }) => row));
  panel.append(element("div", { class: "lighting" }, dome.svg, settings), element("div", { class: "bar" }, off, pause), said);
  return (next) => {
    state = next;
    const idle = next.controls && next.rig && !next.task;
    panel.disabled = !idle;
    if (next.rig) dome.update(next.rig, next.live, new Set(next.plan.leds));
    modes.input.value = next.live.mode;
    for (const { input, name, scale } of numbers) {
      if (document.activeElement !== input) input.value = Number((next.live[name] / scale).toPrecision(6));
    }
    pause.setAttribute("aria-pressed", String(next.live.paused));
  };
}
