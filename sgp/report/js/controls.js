// Controls of the relightable view: what a pane shows, the circling light, waiting.

import { remember } from "./address.js";
import { element, selection } from "./elements.js";
import { modesOf } from "./modes.js";

/** Return the selection of a pane: the result, if there are several, and the mode. */
export function picker(pane, index, results, changed) {
  const side = index === 0 ? "Picture" : "Second picture";
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
      selection(index === 0 ? "Result" : "Second result", names, String(results.indexOf(pane.result)), (value) => {
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
export function animation(light) {
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
export function later(action, milliseconds = 120) {
  let timer = 0;
  return (value) => {
    clearTimeout(timer);
    timer = setTimeout(() => action(value), milliseconds);
  };
}
