// Marks: lists of points with a text, in the page's address and in files.

import { remember, remembered } from "../address.js";

const FORMAT = "sgp-annotations";
const MOST_MARKS = 200;
const MOST_POINTS = 200;
export const MOST_LETTERS = 500;

export class Marks {
  /** The marks of a result: read from the address and kept there. */
  constructor(key) {
    this.key = key;
    this.list = [];
    this.recall();
  }

  /** Read the address; returns whether the marks have changed. */
  recall() {
    const before = JSON.stringify(this.list);
    try {
      this.list = checked(JSON.parse(remembered(this.key) ?? "[]"));
    } catch {
      this.list = [];
    }
    return JSON.stringify(this.list) !== before;
  }

  keep() {
    remember(this.key, this.list.length > 0 ? JSON.stringify(this.list) : null);
  }

  /** Add a mark and return its place; throws an Error if there are too many. */
  add(points, text = "") {
    this.list = checked([...this.list, { points, text }]);
    this.keep();
    return this.list.length - 1;
  }

  remove(place) {
    this.list.splice(place, 1);
    this.keep();
  }

  describe(place, text) {
    this.list[place].text = text.slice(0, MOST_LETTERS);
    this.keep();
  }

  /** Return the text of a file with the marks; `figures` are those of each mark. */
  written(name, unit, figures) {
    const marks = this.list.map((mark, i) => ({ ...mark, figures: figures[i] }));
    return `${JSON.stringify({ format: FORMAT, version: 1, result: name, unit, marks }, null, 2)}\n`;
  }

  /** Replace the marks by those of a file; throws an Error that says what is wrong. */
  read(text, unit) {
    let content;
    try {
      content = JSON.parse(text);
    } catch {
      throw new Error("is not a JSON file");
    }
    if (content?.format !== FORMAT) throw new Error("is not a file of annotations");
    if (content.version !== 1) throw new Error(`has version ${content.version}; this page reads version 1`);
    if (content.unit !== unit) throw new Error(`has lengths in ${content.unit}, and this result in ${unit}`);
    this.list = checked(content.marks);
    this.keep();
  }
}

function checked(marks) {
  if (!Array.isArray(marks)) throw new Error("has no list of marks");
  if (marks.length > MOST_MARKS) throw new Error(`has more than ${MOST_MARKS} marks`);
  return marks.map((mark, i) => {
    const points = mark?.points;
    const good = Array.isArray(points) && points.length > 0 && points.length <= MOST_POINTS;
    if (!good || !points.every((one) => Array.isArray(one) && one.length === 2 && one.every(Number.isFinite))) {
      throw new Error(`mark ${i + 1} has no list of points [x, y]`);
    }
    return { points, text: String(mark.text ?? "").slice(0, MOST_LETTERS) };
  });
}
