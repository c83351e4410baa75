// The operator's screen: it shows the state of the station, and sends what the operator asks for.

import { Dome } from "./dome.js";
import { drawing, element } from "./elements.js";
import { FocusHistory, drawHistogram } from "./graphs.js";
import { ask, listen } from "./link.js";
import { planPanel } from "./plan.js";
import { recordPanel } from "./record.js";
import { lightPanel } from "./light.js";
import { questionBox, results, thumbnails } from "./results.js";
import { View } from "./view.js";

const at = (id) => document.getElementById(id);

const view = new View(at("view"), at("caption"), (region) => {
  if (state?.controls) ask({ do: "region", ...region });
});
const focus = new FocusHistory(at("focus"), at("focus-text"));
at("viewing").append(
  ...view.buttons(),
  element("button", { type: "button", onclick: () => document.documentElement.classList.toggle("bright") }, "Bright page"),
);
const panels = [
  lightPanel(at("light"), (choose) => new Dome(drawing("svg", { class: "map", viewBox: "-112 -112 224 224", role: "group", "aria-label": "LEDs" }), choose)),
  planPanel(at("plan")),
  recordPanel(at("record")),
  questionBox(at("question")),
  results(at("results")),
  thumbnails(at("thumbnails")),
];
let state = null;
let drawn; // number of the frame whose figures are on display
at("stop").addEventListener("click", () => ask({ do: "stop" }));

listen(
  (next) => {
    state = next;
    show(next);
  },
  () => trouble("the station does not answer: is the program still running?"),
);

function trouble(text) {
  at("trouble").textContent = text;
  at("trouble").hidden = !text;
}

function show(next) {
  const { rig, live } = next;
  trouble(next.trouble || next.failure);
  at("rig").textContent = [
    rig ? `${rig.name}, ${rig.camera}` : "the rig is not open",
    `${live.rate_hz.toFixed(1)} frames/s`,
    next.controls ? "" : "read only: another page controls the rig",
  ]
    .filter(Boolean)
    .join("; ");
  at("stop").disabled = !next.controls;
  if (rig) view.size(rig.size);
  view.mmPerPx = next.mm_per_px;
  const { frame } = live;
  if (frame.number !== drawn) {
    drawn = frame.number;
    drawHistogram(at("histogram"), at("histogram-text"), frame);
    focus.add(frame.sharpness, JSON.stringify([frame.leds, frame.exposure_us, frame.gain_db, view.inView()]));
  }
  for (const panel of panels) panel(next);
}
