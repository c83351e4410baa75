// The map of the LEDs: as the camera sees them, or in a ring if their places are not known.

import { drawing } from "./elements.js";

const RADIUS = 100;
const LAMP = 11;
const STEPS = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 };

/** Draw the LEDs of a rig; `choose(led, more)` is called for a click or Enter. Arrows go to the next LED. */
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
    const centres = places(rig);
    const radius = Math.min(LAMP, 0.47 * closest(centres));
    const rings = [1, 0.866, 0.5].map((share) => drawing("circle", { class: "ring", r: RADIUS * share }));
    this.lamps = centres.map(([x, y], led) => {
      const dead = rig.dead_leds.includes(led);
      const circle = drawing("circle", { class: "lamp", cx: x, cy: y, r: radius });
      const act = (event) => {
        if (!dead) this.choose(led, event.shiftKey || event.ctrlKey);
      };
      const group = drawing(
        "g",
        {
          role: "button",
          tabindex: "-1",
          "aria-label": dead ? `LED ${led}, dead` : `LED ${led}`,
          "aria-disabled": dead ? "true" : null,
          onclick: act,
          onfocus: () => this.enter(led),
          onkeydown: (event) => {
            if (STEPS[event.key]) {
              event.preventDefault();
              this.lamps.at((led + STEPS[event.key]) % rig.leds).group.focus();
            }
            if (event.key !== "Enter" && event.key !== " ") return;
            event.preventDefault();
            act(event);
          },
        },
        circle,
        drawing("text", { x, y, "font-size": radius }, String(led)),
      );
      return { group, circle };
    });
    this.svg.replaceChildren(...rings, ...this.lamps.map(({ group }) => group));
    this.enter(0);
  }

  /** Let Tab reach this LED, and no other one. */
  enter(led) {
    this.lamps.forEach(({ group }, other) => group.setAttribute("tabindex", other === led ? "0" : "-1"));
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

/** Return the smallest distance of two places. */
function closest(places) {
  const distances = places.flatMap(([x, y], i) => places.slice(0, i).map(([u, v]) => Math.hypot(x - u, y - v)));
  return Math.min(2 * RADIUS, ...distances);
}
