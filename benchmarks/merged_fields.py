"""Fields that ``sgp merge`` joins: placements, seams, shape against truth, and cost.

A painted relief with structure of all widths is cut into overlapping fields, which are moved and
turned by up to 2 degrees and have other gains; the camera is tilted against the object. Commands
run in processes of their own, with limited memory.

``seam sigma`` is the step of the errors of the normals across the borders of fields, means over
64 x 4 pixels on both sides, in standard deviations of one normal. ``shape`` is the rms error of the
heights of ``sgp surface`` after a quadratic surface through known heights in the middles of the
fields has been subtracted; ``of single`` is the same relative to a single field of the size of the
whole, with the same noise and known heights.

    python benchmarks/merged_fields.py --seed 45 --out docs/measured/merged-fields.csv
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path

import numpy as np
from harness import Table, alone, command_line, resident_bytes
from relief_fields import Relief, View, relief, seen, true_normals, write_field
from scipy.ndimage import map_coordinates

from acquisition import read_image, read_mask
from processing import NormalMap
from processing.registration import Field
from rig.arrays import Bool, Float32, Float64
from sgp.app import build, run

_OVERLAP = 0.15
# Height of the fields in pixels, and rms tilt in degrees.
_CASES = ((400, 0.0), (400, 0.3), (1200, 0.0))
# Share of the size of a field by which it is away from its regular place.
_JITTER = 0.01
_TURN_DEG = 2.0
_SIGMA_DEG = 1.0
# Along and across a border, px, and distance of the nearest line of pixels from it.
_SEGMENT, _LINES, _BESIDE = 64, 4, 2
_BAND = 256


def views_of(grid: int, size: tuple[int, int], tilt_deg: float, seed: int) -> list[View]:
    """Return grid x grid views in random order."""
    rng = np.random.default_rng(seed)
    height, width = size
    views = []
    for row, column in np.ndindex(grid, grid):
        off = rng.uniform(-_JITTER, _JITTER, 2)
        tilt = rng.normal(0, tilt_deg, 2)
        views.append(
            View(
                width * (0.7 + (1 - _OVERLAP) * column + off[0]),
                height * (0.7 + (1 - _OVERLAP) * row + off[1]),
                np.radians(rng.uniform(-_TURN_DEG, _TURN_DEG)),
                rng.uniform(0.8, 1.25),
                _SIGMA_DEG,
                (tilt[0], tilt[1]),
            )
        )
    return [views[k] for k in rng.permutation(len(views))]


def command(*words: object) -> tuple[float, float]:
    """Run a command of sgp in a process of its own; return CPU seconds and peak memory in MB."""
    return alone(_run, [str(word) for word in words])


def _run(words: list[str]) -> tuple[float, float]:
    if run(build(words), words):
        raise RuntimeError(f"sgp {words[0]} failed")
    return time.process_time(), resident_bytes("VmHWM") / 1e6


def matrices_of(record: dict[str, object], size: tuple[int, int]) -> list[Float64]:
    """Return matrices from fields to the whole."""
    return [
        View(one["column_px"], one["row_px"], np.radians(one["turn_deg"])).matrix(size)
        for one in record["metrics"]["fields"]  # type: ignore[index]
    ]


def errors_of(
    whole: Relief, normals: Float32, into: Float64, turn: float
) -> tuple[Float32, Float64]:
    """Return the errors ``(H, W, 2)`` in degrees, and true heights ``(H, W)``."""
    errors = np.zeros((*normals.shape[:2], 2), np.float32)
    heights = np.zeros(normals.shape[:2], np.float32)
    limits = np.array(whole.height.shape)[::-1, None, None] - 1
    cos, sin = np.cos(turn), np.sin(turn)
    for top in range(0, len(normals), _BAND):
        part = normals[top : top + _BAND]
        rows, columns = np.indices(part.shape[:2], np.float64)
        where = np.stack([columns, rows + top, np.ones_like(rows)])
        x, y = np.clip(np.tensordot(into[:2], where, 1), 0, limits)
        right, up, _ = np.moveaxis(true_normals(whole, x, y), 2, 0)
        true = np.stack([cos * right - sin * up, sin * right + cos * up], axis=2)
        errors[top : top + _BAND] = np.degrees(part[..., :2] - true)
        first = max(0, int(y.min()) - 2)
        near = whole.height[first : int(y.max()) + 3]
        heights[top : top + _BAND] = map_coordinates(near, [y - first, x], order=1)
    return errors, heights


def seams(
    errors: Float32, mask: Bool, sigma: float, matrices: list[Float64], size: tuple[int, int]
) -> Float64:
    """Return the steps across the borders of all fields in standard deviations."""
    height, width = size
    steps = []
    for matrix in matrices:
        for length, at in ((width, 0), (width, height - 1), (height, 0), (height, width - 1)):
            along = np.arange(length // _SEGMENT * _SEGMENT)
            means = []
            for side in (-1, 1):
                away = at + side * np.arange(_BESIDE, _BESIDE + _LINES)
                u, v = np.meshgrid(along, away)
                ends = (u, v) if length == width and at in (0, height - 1) else (v, u)
                x, y, _ = np.tensordot(matrix, np.stack([*ends, np.ones_like(u)]), 1)
                x, y = np.rint(x).astype(int), np.rint(y).astype(int)
                inside = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
                x, y = np.where(inside, x, 0), np.where(inside, y, 0)
                inside &= mask[y, x]
                values = np.where(inside[..., None], errors[y, x], np.nan)
                means.append(values.reshape(_LINES, -1, _SEGMENT, 2).mean(axis=(0, 2)))
            steps.append((means[1] - means[0]) / sigma)
    found = np.concatenate(steps)
    return np.asarray(found[np.isfinite(found)])


def shape_error(height: Float32, true: Float32, known: Float64) -> float:
    """Return the rms error of heights whose quadratic part known heights (x, y) determine."""
    off = height - true
    scale = max(off.shape)

    def terms(x: Float64, y: Float64) -> Float64:
        u, v = x / scale, y / scale
        return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)

    columns, rows = np.rint(known).astype(int).T
    fit = np.linalg.lstsq(terms(*known.T), off[rows, columns], rcond=None)[0]
    rows, columns = np.nonzero(np.isfinite(off[::4, ::4]))
    left = off[::4, ::4][rows, columns] - terms(4.0 * columns, 4.0 * rows) @ fit
    return float(np.sqrt(np.mean(left**2)))


def single(whole: Relief, corner: tuple[int, int], size: tuple[int, int], seed: int) -> Field:
    """Return one field of the size of the whole, without a turn."""
    rng = np.random.default_rng(seed)
    part = whole.height[corner[1] : corner[1] + size[0], corner[0] : corner[0] + size[1]]
    down, right = np.gradient(part)
    normals = np.dstack([-right, down, np.ones_like(right)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    sigma = _SIGMA_DEG * rng.uniform(0.7, 1.3, part.shape).astype(np.float32)
    for axis in range(3):
        noise = rng.standard_normal(part.shape, np.float32)
        normals[..., axis] += noise * np.radians(sigma) / np.sqrt(2)
    return Field(NormalMap.from_vectors(normals), None, sigma)


def measured(
    place: Path, grid: int, size: tuple[int, int], tilt_deg: float, memory: str, seed: int
) -> dict[str, str]:
    """Return a row of the table."""
    views = views_of(grid, size, tilt_deg, seed)
    total = [int(length * (1.4 + (1 - _OVERLAP) * (grid - 1))) for length in size]
    whole = relief((total[0], total[1]), seed)
    folders = [place / f"field-{number:02d}" for number in range(len(views))]
    for number, (folder, view) in enumerate(zip(folders, views, strict=True)):
        write_field(folder, seen(whole, view, size, 1000 * seed + number)[0])
    out = place / "whole"
    merge_s, merge_mb = command("merge", *folders, "--out", out, "--memory", memory)
    record = json.loads((out / "merge.json").read_text())
    matrices = matrices_of(record, size)
    into = views[0].matrix(size) @ np.linalg.inv(matrices[0])
    corners = np.array([[0, size[1] - 1, 0], [0, 0, size[0] - 1], [1, 1, 1.0]])
    off = [
        np.linalg.norm((into @ one - view.matrix(size)) @ corners, axis=0)
        for one, view in zip(matrices, views, strict=True)
    ]
    mask = read_mask(out / "mask.png")
    errors, heights = errors_of(whole, read_image(out / "normals.exr"), into, views[0].turn)
    sigma = read_image(out / "normal_sigma_deg.exr")
    stated = np.sqrt(np.mean(np.square(sigma[mask], dtype=np.float64)))
    rms = np.sqrt(np.mean(np.square(errors[mask], dtype=np.float64).sum(axis=1)))
    # One component of a normal.
    steps = seams(errors, mask, float(np.nanmedian(sigma)) / np.sqrt(2), matrices, size)
    weights = ("--sigma", out / "normal_sigma_deg.exr", "--memory", memory, "--smooth")
    surface_s, surface_mb = command("surface", out, *weights, "--out", place / "surface")
    middle = [(size[1] - 1) / 2, (size[0] - 1) / 2, 1]
    known = np.array([(one @ middle)[:2] for one in matrices])
    shape = shape_error(read_image(place / "surface" / "height.exr"), heights, known)
    corner = (int(known[:, 0].min() * 0.2), int(known[:, 1].min() * 0.2))
    extent = min(mask.shape[0], total[0] - corner[1]), min(mask.shape[1], total[1] - corner[0])
    alone = write_field(place / "single", single(whole, corner, extent, seed + 1))
    weights = ("--sigma", alone / "normal_sigma_deg.exr", "--memory", memory, "--smooth")
    command("surface", alone, *weights, "--out", place / "single-surface")
    true = whole.height[corner[1] : corner[1] + extent[0], corner[0] : corner[0] + extent[1]]
    beside = read_image(place / "single-surface" / "height.exr")
    inside = np.clip(known, 0, np.array(extent)[::-1] - 1)
    compared = shape_error(beside, true, inside)
    pairs = record["metrics"]["pairs"]
    return {
        "fields": str(len(views)),
        "field Mpx": f"{size[0] * size[1] / 1e6:.2f}",
        "whole Mpx": f"{mask.size / 1e6:.1f}",
        "tilt deg": f"{tilt_deg:g}",
        "pairs": str(sum(pair["used"] for pair in pairs)),
        "place px": f"{np.sqrt(np.mean(np.square(off))):.3f}",
        "largest px": f"{np.max(off):.3f}",
        "normals deg": f"{rms:.3f}",
        "stated deg": f"{stated:.3f}",
        "seam sigma": f"{np.sqrt(np.mean(steps**2)):.3f}",
        "largest seam": f"{np.abs(steps).max():.2f}",
        "shape px": f"{shape:.3f}",
        "of single": f"{shape / compared:.2f}",
        "merge cpu s": f"{merge_s:.0f}",
        "merge MB": f"{merge_mb:.0f}",
        "surface cpu s": f"{surface_s:.0f}",
        "surface MB": f"{surface_mb:.0f}",
    }


def main() -> None:
    """Print one row for each size of the fields and tilt."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=45, help="seed of relief, noise and places")
    parser.add_argument("--grid", type=int, default=5, help="fields along each side")
    parser.add_argument("--memory", default="1500M", help="of the commands")
    parser.add_argument("--out", type=Path, help="table (.csv)")
    options = parser.parse_args()
    table = Table(options.out)
    for height, tilt in _CASES:
        size = height, round(height * 1.39)
        with tempfile.TemporaryDirectory() as place:
            table.add(measured(Path(place), options.grid, size, tilt, options.memory, options.seed))


if __name__ == "__main__":
    main()
