// The page: reads its data, makes a tab for the light and for each other view, and opens the first one.

import { remember, remembered } from "./address.js";
import { element } from "./elements.js";
import { drawMaps } from "./gallery.js";
import { label, mount } from "./relight.js";
import { Result } from "./result.js";

export function start(views) {
  printDetails();
  const report = JSON.parse(document.getElementById("report").textContent);
  const results = report.results.map((description) => new Result(description));
  const place = document.getElementById("views");
  if (!place || results.length === 0) return;
  if (typeof DecompressionStream === "undefined") return;
  const tabs = element("div", { role: "tablist", class: "tabs", "aria-label": "Views" });
  const panels = [{ id: "relight", label, mount }, ...views].map((view) => panel(view, tabs, results, report));
  if (panels.length > 1) place.append(tabs);
  place.append(...panels.map((one) => one.body));
  const choose = (chosen) => panels.forEach((one) => one.select(one === chosen));
  const turn = (chosen) => {
    choose(chosen);
    remember("view", chosen.id);
  };
  panels.forEach((one) => {
    one.tab.addEventListener("click", () => turn(one));
    one.tab.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!step) return;
      const next = panels[(panels.indexOf(one) + step + panels.length) % panels.length];
      turn(next);
      next.tab.focus();
    });
  });
  choose(panels[0]);
  const asked = panels.find((one) => one.id === remembered("view"));
  if (asked) choose(asked);
  // Views send events without an address to each other.
  window.addEventListener("hashchange", ({ newURL }) => {
    const wanted = newURL && panels.find((one) => one.id === remembered("view", newURL));
    if (wanted) choose(wanted);
  });
  drawMaps(results, report.colourMaps);
}

/** Open what is folded while the page is printed. */
function printDetails() {
  let folded = [];
  const open = (value) => folded.forEach((one) => (one.open = value));
  window.addEventListener("beforeprint", () => {
    folded = [...document.querySelectorAll("details:not([open])")];
    open(true);
  });
  window.addEventListener("afterprint", () => open(false));
}

function panel(view, tabs, results, report) {
  const name = `view-${view.id}`;
  const tab = element("button", { role: "tab", id: `${name}-tab`, "aria-controls": name, type: "button" }, view.label);
  const body = element("div", { role: "tabpanel", id: name, "aria-labelledby": `${name}-tab`, class: "view" });
  tabs.append(tab);
  let mounted = null;
  const mount = async () => {
    try {
      const data = await results[0].data();
      return await view.mount(body, { ...data, results, report });
    } catch (error) {
      body.replaceChildren(element("p", { class: "failed", role: "alert" }, `This view cannot be shown: ${error.message}.`));
      return null;
    }
  };
  const select = async (chosen) => {
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
    body.hidden = !chosen;
    if (!chosen && mounted === null) return;
    mounted ??= mount();
    const shown = await mounted;
    (chosen ? shown?.show : shown?.hide)?.();
  };
  return { id: view.id, tab, body, select };
}
