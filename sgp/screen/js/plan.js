// The plan: its text, metering and the checks before a recording.

import { element } from "./elements.js";
import { ask } from "./link.js";

/** Fill the panel; returns a function that shows a state. */
export function planPanel(panel) {
  const text = element("textarea", { spellcheck: "false", "aria-label": "Plan, as in a plan file" });
  const said = element("p", { class: "said", role: "status" });
  const button = (label, action) =>
    element("button", { type: "button", onclick: async () => say(await ask(action)) }, label);
  const say = (error) => {
    if (error) said.textContent = error;
    said.classList.toggle("error", Boolean(error));
  };
  let later = 0;
  let shown = null;
  const write = async () => {
    clearTimeout(later);
    say(await ask({ do: "plan", text: text.value }));
  };
  text.addEventListener("input", () => {
    clearTimeout(later);
    later = setTimeout(write, 400);
  });
  text.addEventListener("change", write); // before the click on a button
  panel.append(
    text,
    said,
    element(
      "div",
      { class: "bar" },
      button("Meter each LED", { do: "meter", each: true }),
      button("Meter all alike", { do: "meter", each: false }),
      button("Check", { do: "check" }),
    ),
  );
  return ({ controls, rig, task, plan }) => {
    panel.disabled = !controls || !rig || Boolean(task);
    if (document.activeElement !== text || panel.disabled) text.value = plan.text;
    const line = plan.error || `${plan.shots} shots, about ${seconds(plan.seconds)}`;
    if (line !== shown) {
      shown = line;
      said.textContent = line;
      said.classList.toggle("error", Boolean(plan.error));
    }
  };
}

/** Return a duration for people. */
export function seconds(value) {
  const whole = Math.round(value);
  return whole < 100 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}
