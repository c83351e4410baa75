// The light: a direction on the dome, distant or near, and the control that turns it.

import { drawing } from "./elements.js";

const RADIUS = 90;
/** Elevation of raking light above the horizon in degrees. */
export const RAKING_DEG = 10;
const STEP_DEG = 5;

export class Light {
  constructor() {
    this.azimuth = 135; // degrees, counterclockwise from the right
    this.elevation = 45; // degrees above the horizon
    this.near = false;
    this.distance = 1; // of a near light, relative to the diagonal of the map
    this.listeners = [];
  }

  get direction() {
    const around = (this.azimuth * Math.PI) / 180;
    const up = (this.elevation * Math.PI) / 180;
    return [Math.cos(up) * Math.cos(around), Math.cos(up) * Math.sin(around), Math.sin(up)];
  }

  /** Turn to a direction; x and y are limited to the dome. */
  turnTo(x, y) {
    const away = Math.min(1, Math.hypot(x, y));
    if (away > 1e-6) this.azimuth = (Math.atan2(y, x) * 180) / Math.PI;
    this.elevation = Math.max(1, (Math.acos(away) * 180) / Math.PI);
    this.changed();
  }

  turn(azimuth, elevation) {
    this.azimuth = (((this.azimuth + azimuth) % 360) + 360) % 360;
    this.elevation = Math.min(90, Math.max(1, this.elevation + elevation));
    this.changed();
  }

  set(values) {
    Object.assign(this, values);
    this.changed();
  }

  changed() {
    for (const listener of this.listeners) listener();
  }

  get text() {
    const round = (value) => Math.round(value);
    return `azimuth ${round(this.azimuth)}°, elevation ${round(this.elevation)}°`;
  }
}

/** Move the light with the arrow keys; returns whether the key was one of them. */
export function turnByKey(light, key) {
  const turns = { ArrowLeft: [STEP_DEG, 0], ArrowRight: [-STEP_DEG, 0], ArrowUp: [0, STEP_DEG], ArrowDown: [0, -STEP_DEG] };
  if (!(key in turns)) return false;
  light.turn(...turns[key]);
  return true;
}

/** Return the dome as a control: the camera sees it from above; `recorded` are directions. */
export function dome(light, recorded) {
  const rings = [30, 60, 90].map((deg) =>
    drawing("circle", { r: RADIUS * Math.sin((deg * Math.PI) / 180), class: "ring" }),
  );
  const dots = recorded.map(([x, y]) => drawing("circle", { cx: RADIUS * x, cy: -RADIUS * y, r: 2.5, class: "recorded" }));
  const ray = drawing("line", { class: "ray" });
  const handle = drawing("circle", { r: 9, class: "handle" });
  const control = drawing(
    "svg",
    { viewBox: "-100 -100 200 200", class: "dome", tabindex: 0, role: "slider", "aria-label": "Light: arrow keys turn and raise it", "aria-valuemin": 0, "aria-valuemax": 90 },
    ...rings,
    ...dots,
    ray,
    handle,
  );
  const show = () => {
    const [x, y] = light.direction;
    for (const [name, value] of [["cx", RADIUS * x], ["cy", -RADIUS * y]]) handle.setAttribute(name, value);
    ray.setAttribute("x2", RADIUS * x);
    ray.setAttribute("y2", -RADIUS * y);
    control.setAttribute("aria-valuenow", Math.round(light.elevation));
    control.setAttribute("aria-valuetext", light.text);
  };
  light.listeners.push(show);
  show();
  const follow = (event) => {
    const box = control.getBoundingClientRect();
    const scale = 200 / Math.min(box.width, box.height);
    const x = ((event.clientX - box.left - box.width / 2) * scale) / RADIUS;
    const y = ((event.clientY - box.top - box.height / 2) * scale) / RADIUS;
    light.turnTo(x, -y);
  };
  control.addEventListener("pointerdown", (event) => {
    control.setPointerCapture(event.pointerId);
    follow(event);
  });
  control.addEventListener("pointermove", (event) => {
    if (control.hasPointerCapture(event.pointerId)) follow(event);
  });
  control.addEventListener("keydown", (event) => {
    if (turnByKey(light, event.key)) event.preventDefault();
  });
  return control;
}
