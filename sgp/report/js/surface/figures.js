// Figures as text, with their standard deviations.

const SIGNIFICANT = 5;
const THREE = 3; // significant digits of parameters
const LEAST = 4; // significant digits of a value whose standard deviation is larger

/** Write a length or an area; with two digits of its standard deviation, if that is known. */
export function quantity(value, unit, sigma = NaN) {
  if (Number.isNaN(value)) return "not known";
  if (!(sigma > 0)) return `${sign(Number(value.toPrecision(SIGNIFICANT)).toString())} ${unit}`;
  const digits = Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(sigma))));
  const own = LEAST - 1 - Math.floor(Math.log10(Math.abs(value) || sigma));
  return `${sign(value.toFixed(Math.min(9, Math.max(digits, own))))} ± ${sigma.toFixed(digits)} ${unit}`;
}

const sign = (text) => text.replace("-", "\u2212");

/** Return the figures of a mark as [name, text]. */
export function described(found, unit) {
  if (found.kind === "point") {
    return [
      ["Place", `x ${quantity(found.x, unit)}, y ${quantity(found.y, unit)}`],
      ["Height", quantity(found.height, unit, found.heightSigma)],
    ];
  }
  if (found.kind === "distance") {
    if (Number.isNaN(found.distance)) return [["Distance", "not known: one end is off the surface"], ["Distance seen from the front", quantity(found.across, unit)]];
    return [
      ["Distance", quantity(found.distance, unit)],
      ["Height difference", quantity(found.difference, unit, found.differenceSigma)],
      ["Distance seen from the front", quantity(found.across, unit)],
      ["Along the surface", Number.isNaN(found.along) ? "not known: the surface has gaps on the way" : quantity(found.along, unit)],
    ];
  }
  if (found.crossing) return [["Area", "not known: the sides of the polygon cross"]];
  const part = found.missing > 0.0005 ? ` (${(100 * (1 - found.missing)).toFixed(1)} % of the polygon has a surface)` : "";
  return [
    ["Area seen from the front", quantity(found.area, `${unit}²`)],
    ["Area of the surface", quantity(found.surface, `${unit}²`) + part],
    ...(found.roughness ? rough(found.roughness) : []),
  ];
}

function rough({ region, sFilter, ...values }) {
  const filter = `S-filter ${sFilter} mm`;
  if (values.Sa === undefined) return [["Roughness", `not defined: the rectangle is smaller than the ${filter}`]];
  const short = (value) => sign(String(Number(value.toPrecision(THREE))));
  const height = (value) => `${short(value)} µm`;
  const where = region ? `region ${region}` : "reduced heights, so that the values differ from those of sgp roughness";
  return [
    ["Sa, Sq, Sz", [values.Sa, values.Sq, values.Sz].map(height).join(", ")],
    ["Ssk, Sku", [values.Ssk, values.Sku].map(short).join(", ")],
    ["Roughness of", `${where}; form plane, ${filter}, no L-filter, noise included`],
  ];
}

/** Return the figures without those that are not known, for a file. */
export function forFile(found) {
  return Object.fromEntries(Object.entries(found).filter(([, value]) => !Number.isNaN(value)));
}
