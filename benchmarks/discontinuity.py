"""Surfaces with jumps in depth: errors on captured objects with known depth, and costs.

``--data`` is a folder with the objects of DiLiGenT, each with ``normal_map.png``, ``mask.png``,
``K.txt`` and ``depth_gt.npz`` (mm). All objects have one set of parameters. The error is the mean
absolute error of the depth over every pixel of the mask, after scaling by the median of true by
estimated depth, of surfaces that are smooth, by default, and with jumps in any case. "prior" has
one known height in each piece between jumps that has at least 1 % of the pixels; "bound" is the
error if each piece had its best scale; "noise" are mean errors over seeds with noise on each
component of the normals. "spanning" counts triangles of the default that span a true step of more
than 5 mm.

    python benchmarks/discontinuity.py --data diligent --out docs/measured/surface-objects.csv
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from harness import Table, alone, command_line, measured

import processing
from benchmarks.paper.surface import error_mm, object_of
from processing.surface.jumps import SHARPNESS
from rig.arrays import Float64, Int32

# Mean errors in mm of the authors' code of bilateral normal integration.
BINI = {
    "bear": 0.334,
    "buddha": 1.098,
    "cat": 0.074,
    "cow": 0.058,
    "goblet": 9.02,
    "harvest": 1.838,
}
STEP_MM = 5.0
# Smaller pieces have no known height.
LEAST_SHARE = 0.01


def noisy(normals: processing.NormalMap, noise_deg: float, seed: int) -> processing.NormalMap:
    """Return normals with noise on each component."""
    noise = np.random.default_rng(seed).normal(scale=np.radians(noise_deg), size=(*normals.size, 3))
    return processing.NormalMap.from_vectors(normals.normals + noise, normals.mask)


def pieces_of(surface: processing.HeightMap) -> Int32:
    if surface.jumps is None:
        raise ValueError("jumps were not looked for")
    return surface.jumps.pieces


def bound_mm(surface: processing.HeightMap, depth: Float64) -> float:
    """Return the mean error if each piece between jumps had its best scale."""
    pieces, estimate = pieces_of(surface), np.asarray(surface.depth)
    errors = []
    for piece in range(int(pieces.max()) + 1):
        inside = pieces == piece
        ratio = depth[inside] / estimate[inside]
        errors.append(np.abs(ratio - np.median(ratio)) * estimate[inside])
    return float(np.concatenate(errors).mean())


def spanning(surface: processing.HeightMap, depth: Float64) -> int:
    """Return the number of triangles whose corners differ by more than STEP_MM in true depth."""
    corners = depth[surface.mask][processing.height_mesh(surface).faces]
    return int(np.count_nonzero(np.ptp(corners, axis=1) > STEP_MM))


def large_map(pixels: int) -> processing.NormalMap:
    """Return normals of overlapping balls on a wavy ground, with 1 degree of noise."""
    n = round(pixels**0.5)
    y, x = (a.astype(np.float32) for a in np.mgrid[1 : -1 : n * 1j, -1 : 1 : n * 1j])
    height = 0.02 * np.sin(9 * x) * np.cos(7 * y)
    normals = np.dstack(
        [-0.18 * np.cos(9 * x) * np.cos(7 * y), 0.14 * np.sin(9 * x) * np.sin(7 * y), 1 + 0 * x]
    )
    rng = np.random.default_rng(0)
    for _ in range(30):
        u, v = rng.uniform(-0.9, 0.9, 2)
        radius = rng.uniform(0.08, 0.3)
        squared = radius**2 - (x - u) ** 2 - (y - v) ** 2
        ball = np.sqrt(np.maximum(squared, 1e-9)) - 0.4 * radius
        nearer = (squared > 0) & (ball > height)
        height[nearer] = ball[nearer]
        normals[nearer] = (np.dstack([x - u, y - v, ball + 0.4 * radius]) / radius)[nearer]
    noise = rng.normal(scale=np.radians(1), size=normals.shape)
    return processing.NormalMap.from_vectors(normals + noise)


def cost(pixels: int) -> tuple[float, float, int]:
    """Return CPU seconds, bytes per pixel and iterations of an integration with jumps."""
    small, normals = large_map(10_000), large_map(pixels)
    processing.integrate(small, discontinuity=True)  # compiles
    spent, surface = measured(lambda: processing.integrate(normals, discontinuity=True))
    return spent.cpu_s, spent.peak_bytes / pixels, surface.iterations


def prior_mm(normals: processing.NormalMap, surface: processing.HeightMap, depth: Float64) -> float:
    """Return the mean error with a known height in the middle of each large piece."""
    camera = surface.camera
    if camera is None:
        raise ValueError("the objects have cameras")
    mask = normals.mask
    distance = float(np.median(depth[mask]))
    places = []
    pieces = pieces_of(surface)
    for piece in range(int(pieces.max()) + 1):
        rows, columns = np.nonzero(pieces == piece)
        if len(rows) >= LEAST_SHARE * np.count_nonzero(mask):
            middle = np.hypot(rows - rows.mean(), columns - columns.mean()).argmin()
            places.append((columns[middle], rows[middle]))
    heights = [distance - depth[row, column] for column, row in places]
    prior = processing.HeightPrior.from_points(places, heights, 0.01, mask.shape)
    held = replace(camera, working_distance_mm=distance)
    found = processing.integrate(normals, camera=held, prior=prior)
    return error_mm(found, depth, mask)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the objects")
    parser.add_argument("--k", type=float, default=SHARPNESS, help="sharpness")
    parser.add_argument("--noise-deg", type=float, default=3.0, help="noise of the normals")
    parser.add_argument("--seeds", type=int, default=3, help="seeds of the noise")
    parser.add_argument("--first-seed", type=int, default=1000, help="the first of them")
    parser.add_argument(
        "--pixels", type=int, nargs="*", default=[300_000, 1_000_000], help="sizes for the costs"
    )
    parser.add_argument("--out", type=Path, help="table of the objects (.csv)")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    table = Table(options.out)
    ways = {"smooth": False, "default": None, "jumps": True}
    for folder in sorted(path for path in options.data.iterdir() if (path / "K.txt").exists()):
        normals, camera, depth = object_of(folder)
        mask = normals.mask
        surfaces = {
            name: processing.integrate(normals, camera=camera, discontinuity=way, k=options.k)
            for name, way in ways.items()
        }
        noisy_errors: dict[str, list[float]] = {name: [] for name in ways}
        for seed in seeds:
            worse = noisy(normals, options.noise_deg, seed)
            for name, way in ways.items():
                found = processing.integrate(worse, camera=camera, discontinuity=way, k=options.k)
                noisy_errors[name].append(error_mm(found, depth, mask))
        row = {"object": folder.name}
        row |= {name: f"{error_mm(each, depth, mask):.3f}" for name, each in surfaces.items()}
        row["prior"] = f"{prior_mm(normals, surfaces['jumps'], depth):.3f}"
        row["bound"] = f"{bound_mm(surfaces['jumps'], depth):.3f}"
        row["BiNI"] = f"{BINI.get(folder.name, np.nan):.3f}"
        row["pieces"] = str(pieces_of(surfaces["jumps"]).max() + 1)
        row |= {f"noise, {name}": f"{np.mean(each):.3f}" for name, each in noisy_errors.items()}
        row["spanning"] = str(spanning(surfaces["default"], depth))
        table.add(row)
    print(f"\n{'pixels':>9} {'CPU s':>7} {'bytes/px':>8} {'iterations':>10}")
    for pixels in options.pixels:
        cpu_s, per_pixel, iterations = alone(cost, pixels)
        print(f"{pixels:9,d} {cpu_s:7.2f} {per_pixel:8.0f} {iterations:10d}", flush=True)


if __name__ == "__main__":
    main()
