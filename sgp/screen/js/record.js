// Recording: what it is called, its progress, and the end at any time.

import { element } from "./elements.js";
import { ask } from "./link.js";
import { seconds } from "./plan.js";

/** Fill the panel; returns a function that shows a state. */
export function recordPanel(panel) {
  const name = element("input", { type: "text", maxlength: 200, autocomplete: "off" });
  const notes = element("input", { type: "text", maxlength: 2000, autocomplete: "off" });
  const check = element("input", { type: "checkbox", checked: true });
  const said = element("p", { class: "said error", role: "alert" });
  const button = (label, kind, action) =>
    element("button", { type: "button", class: kind, onclick: async () => (said.textContent = await ask(action())) }, label);
  const record = button("Record", "primary", () => ({ do: "record", object: name.value, notes: notes.value, check: check.checked }));
  const resume = button("Resume", "", () => ({ do: "resume" }));
  const look = button("Normals", "", () => ({ do: "look" }));
  const bar = element("progress", { max: 1, value: 0, "aria-label": "Progress" });
  const stage = element("p", { class: "said", role: "status" });
  const entries = [name, notes, check];
  panel.append(
    element("label", { class: "field" }, element("span", {}, "Object"), name),
    element("label", { class: "field" }, element("span", {}, "Notes"), notes),
    element("label", { class: "check" }, check, "Check rig and picture first"),
    element("div", { class: "bar" }, record, resume, look),
    bar,
    stage,
    said,
  );
  return ({ controls, rig, task, progress, recording }) => {
    const idle = controls && rig && !task;
    for (const entry of entries) entry.disabled = !idle;
    record.disabled = !idle;
    resume.hidden = recording?.state !== "incomplete";
    resume.disabled = !idle;
    look.hidden = recording?.state !== "complete";
    look.disabled = !idle;
    bar.hidden = !progress;
    if (progress) bar.value = progress.total ? progress.done / progress.total : 0;
    const left = progress?.left_s ? `, about ${seconds(progress.left_s)} left` : "";
    stage.textContent = progress ? `${progress.stage}: ${progress.done} of ${progress.total}${left}` : (task ?? "");
  };
}
