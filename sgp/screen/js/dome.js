// The map of the LEDs: as the camera sees them, or in a ring if their places are not known.

import { drawing } from "./elements.js";

const RADIUS = 100;
const LAMP = 8;

/** Draw the LEDs of a rig; `choose(led, more)` is called for a click or Enter. */
export class Dome {
  constructor(svg, choose) {
    Object.assign(this, { svg, choose, lamps: [], drawn: "" });
  }

  update(rig, { leds, mode }, planned) {
    const key = JSON.stringify([rig.name, rig.leds, rig.dead_leds]);
    if (key !== this.drawn) this.draw(rig, key);
    const chosen = new Set(leds);
    this.lamps.forEach(({ group, circle }, led) => {
      const dead = rig.dead_leds.includes(led);
      const classes = ["lamp", dead && "dead", planned.has(led) && "planned", chosen.has(led) && "chosen"];
      circle.setAttribute("class", classes.filter(Boolean).join(" "));
      group.setAttribute("aria-pressed", String(chosen.has(led)));
    });
    this.svg.setAttribute("data-mode", mode);
  }

  draw(rig, key) {
    this.drawn = key;
    const rings = [1, 0.866, 0.5].map((share) => drawing("circle", { class: "ring", r: RADIUS * share }));
    this.lamps = places(rig).map(([x, y], led) => {
      const dead = rig.dead_leds.includes(led);
      const circle = drawing("circle", { class: "lamp", cx: x, cy: y, r: LAMP });
      const act = (event) => {
        if (!dead) this.choose(led, event.shiftKey || event.ctrlKey);
      };
      const group = drawing(
        "g",
        {
          role: "button",
          tabindex: dead ? null : "0",
          "aria-label": dead ? `LED ${led}, dead` : `LED ${led}`,
          "aria-disabled": dead ? "true" : null,
          onclick: act,
          onkeydown: (event) => {
            if (event.key !== "Enter" && event.key !== " ") return;
            event.preventDefault();
            act(event);
          },
        },
        circle,
        drawing("text", { x, y }, String(led)),
      );
      return { group, circle };
    });
    this.svg.replaceChildren(...rings, ...this.lamps.map(({ group }) => group));
  }
}

/** Return [x, y] of each LED on the map: up is up in the picture. */
function places({ leds, positions_mm: positions }) {
  if (positions.length === leds) {
    return positions.map(([x, y, z]) => {
      const length = Math.hypot(x, y, z) || 1;
      return [(RADIUS * x) / length, (-RADIUS * y) / length];
    });
  }
  return Array.from({ length: leds }, (_, led) => {
    const angle = (2 * Math.PI * led) / leds;
    return [0.9 * RADIUS * Math.sin(angle), -0.9 * RADIUS * Math.cos(angle)];
  });
}
