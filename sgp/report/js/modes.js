// What a pane can show of a result.

const SHADED = [
  ["shaded", "Shaded", ["normals", "albedo"]],
  ["matte", "Shaded, no albedo", ["normals"]],
  ["specular", "Specular enhancement", ["normals"]],
  ["albedo", "Albedo", ["normals", "albedo"]],
  ["normals", "Normals", ["normals"]],
  ["shape", "Shape component, shaded", ["normals", "shape"]],
  ["detail", "Detail component, shaded", ["normals", "shape"]],
  ["curvature", "Mean curvature", ["normals"]],
];

/** Return [key, label] of each mode that the planes of a result allow. */
export function modesOf(result) {
  const found = SHADED.filter(([, , needs]) => needs.every((name) => result.has(name))).map(([key, label]) => [key, label]);
  if (result.images.length >= 3) found.push(["captured", "Captured images"]);
  const scalars = result.planes.filter((plane) => plane.kind === "scalar").map((plane) => [`map:${plane.name}`, plane.label]);
  return [...found, ...scalars];
}
