// Elements of the page from values; texts are never parsed as markup.

const SVG = "http://www.w3.org/2000/svg";

/** Return an element with attributes, listeners (keys that begin with "on") and children. */
export function element(name, attributes = {}, ...children) {
  return filled(document.createElement(name), attributes, children);
}

/** The same for a drawing. */
export function drawing(name, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, name), attributes, children);
}

function filled(made, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

/** Return a labelled slider: {row, input, value, set(value)}; onchange receives the value. */
export function slider(label, { min, max, step, value, shown = String, onchange }) {
  const input = element("input", { type: "range", min, max, step, value });
  const output = element("output", {}, shown(value));
  input.addEventListener("input", () => {
    output.textContent = shown(input.valueAsNumber);
    onchange(input.valueAsNumber);
  });
  const row = element("label", { class: "slider" }, element("span", {}, label), input, output);
  const set = (next) => {
    input.valueAsNumber = next;
    output.textContent = shown(input.valueAsNumber);
    onchange(input.valueAsNumber);
  };
  return { row, input, set };
}

/** Return a labelled selection: {row, input}; options are [value, text]. */
export function selection(label, options, value, onchange) {
  const input = element("select", {}, ...options.map(([key, text]) => element("option", { value: key }, text)));
  input.value = value;
  input.addEventListener("change", () => onchange(input.value));
  return { row: element("label", { class: "field" }, element("span", {}, label), input), input };
}
