"""Mean angular error on five concave, glossy figures with shadows and light from each other.

The figures are heights over a plane: a bowl, folds, a heap of stones, a shell and a dented ball,
each drawn from the seed, with a diffuse colour that varies and a white GGX coat. Distant lights on
a dome cast shadows; diffuse light is reflected from every part of the figure onto the others twice.
The view is along z. Images have the noise of a 12-bit sensor and are clipped at white. Methods are
those of gray images; "default" is `reconstruct` of images in colour, "subtracted" the same with
``interreflection``. Figures are glossy, and matte: without the coat.

    python benchmarks/concave_figures.py --seed 1 --out docs/measured/concave-figures.csv
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from harness import Table, command_line
from materials import dome, recorded

from acquisition import Lights, angle_deg, read_source, write_png
from calibration.radiance import luma
from processing import NormalMap, photometric_stereo, reconstruct
from processing.stereo import METHODS
from rig.arrays import Bool, Float64
from simulator.scene import Ggx, Lambert
from simulator.scene.reflectance import reflectance

_EYE = np.array([0.0, 0.0, 1.0])
# Pixels across a patch that reflects light onto others, and the number of reflections.
_PATCH = 5
_BOUNCES = 2


@dataclass(frozen=True, eq=False)
class Figure:
    """Images ``(N, H, W, 3)`` with noise, and the truth."""

    name: str
    values: Float64
    directions: Float64
    normals: Float64
    mask: Bool


def heights(name: str, size: int, rng: np.random.Generator) -> tuple[Float64, Bool]:
    """Return the height of a figure over pixels of the width ``2 / size``, and where it is."""
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j]
    turn, phase = rng.uniform(0, 2 * np.pi, 2)
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    radius = np.hypot(x, y)
    mask = radius < 0.94
    if name == "bowl":
        depth = rng.uniform(0.5, 0.7)
        z = depth * (radius**2 - 0.12 * np.clip(radius - 0.75, 0, None) * 40 * (radius - 0.75))
        z += 0.02 * np.cos(9 * u + phase) * np.cos(9 * v)
    elif name == "folds":
        warped = u + 0.15 * np.sin(3 * v + phase)
        z = 0.16 * np.abs(np.sin(6.5 * warped)) ** 1.3 + 0.08 * np.cos(2.5 * v)
    elif name == "stones":
        z = np.full_like(x, -0.2)
        for _ in range(14):
            cx, cy = rng.uniform(-0.75, 0.75, 2)
            r, top = rng.uniform(0.2, 0.42), rng.uniform(-0.15, 0.15)
            inside = r * r - (x - cx) ** 2 - (y - cy) ** 2
            stone = top + 0.75 * np.sqrt(np.clip(inside, 0, None))
            z = np.where(inside > 0, np.maximum(z, stone), z)
    elif name == "shell":
        angle = np.arctan2(v, u)
        z = 0.5 - 0.45 * radius**2 + 0.07 * np.cos(14 * radius - 2 * angle + phase)
    else:
        z = 0.8 * np.sqrt(np.clip(1.15 - radius**2, 0, None))
        for _ in range(6):
            cx, cy = rng.uniform(-0.6, 0.6, 2)
            width, dent = rng.uniform(0.1, 0.2), rng.uniform(0.12, 0.24)
            z -= dent * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * width**2))
    return z, mask


@numba.njit(cache=True)
def _seen(z: Float64, step: float, start: Float64, toward: Float64, reach: float) -> bool:
    """Return whether nothing is above the ray from a point of pixels ``(row, column, height)``."""
    across = max(np.hypot(toward[0], toward[1]), 1e-9)
    dx, dy, rise = toward[0] / across, -toward[1] / across, toward[2] / across * step
    t = 1.5
    while t < reach:
        row, column, height = start[0] + t * dy, start[1] + t * dx, start[2] + t * rise
        if height > 1.2 or not (0 <= row < z.shape[0] - 1 and 0 <= column < z.shape[1] - 1):
            return True
        i, j = int(row), int(column)
        a, b = row - i, column - j
        of_surface = (1 - a) * ((1 - b) * z[i, j] + b * z[i, j + 1])
        of_surface += a * ((1 - b) * z[i + 1, j] + b * z[i + 1, j + 1])
        if of_surface > height + 0.1 * step:
            return False
        t += 0.8
    return True


@numba.njit(cache=True)
def _shadows(z: Float64, step: float, directions: Float64, lit: Bool) -> None:
    start = np.zeros(3)
    for k in range(len(directions)):
        for i in range(z.shape[0]):
            for j in range(z.shape[1]):
                if lit[k, i, j]:
                    start[0], start[1], start[2] = i, j, z[i, j]
                    lit[k, i, j] = _seen(z, step, start, directions[k], 1e9)


@numba.njit(cache=True)
def _gathered(
    z: Float64, step: float, normals: Float64, points: Float64, of: Float64, places: Float64,
    area: Float64, light: Float64, out: Float64,
) -> None:  # fmt: skip
    """Write the irradiance of pixels by ``light``, the radiosity of patches, ``(Q, K)``."""
    toward = np.zeros(3)
    start = np.zeros(3)
    for i in range(z.shape[0]):
        for j in range(z.shape[1]):
            n = normals[i, j]
            if n[2] <= 0:
                continue
            start[0], start[1], start[2] = i, j, z[i, j]
            for q in range(len(places)):
                for c in range(3):
                    toward[c] = places[q, c] - points[i, j, c]
                distance2 = (toward**2).sum()
                if distance2 < (3 * step) ** 2:
                    continue
                here, there = (n * toward).sum(), -(of[q] * toward).sum()
                if here <= 0 or there <= 0:
                    continue
                reach = np.hypot(toward[0], toward[1]) / step - 1.5
                if _seen(z, step, start, toward, reach):
                    share = here * there * area[q] / (np.pi * distance2**2)
                    for k in range(light.shape[1]):
                        out[i, j, k] += share * light[q, k]


def figure(name: str, seed: int, size: int, lights: int, *, glossy: bool = True) -> Figure:
    """Return a figure of the given name."""
    rng = np.random.default_rng([seed, len(name)])
    z, mask = heights(name, size, rng)
    step = 2 / size
    dy, dx = np.gradient(z, step)
    normals = np.stack([-dx, dy, np.ones_like(z)], axis=-1)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    directions = dome(lights)
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j]
    tint, f0, rough = rng.uniform(0.15, 0.7, 3), rng.uniform(0.04, 0.2), rng.uniform(0.15, 0.4)
    material = Ggx(rough, f0) if glossy else Lambert()
    wave = 0.85 + 0.15 * np.sin(rng.uniform(3, 6, 3) * x[..., None] + rng.uniform(0, 6, 3))
    albedo = tint * wave
    lit = np.einsum("nc,hwc->nhw", directions, normals) > 0
    _shadows(z, step, directions, lit)
    shading = np.where(lit, np.einsum("nc,hwc->nhw", directions, normals), 0)
    to_light = directions[:, None, None]
    images = np.stack(
        [
            shading * reflectance(material, albedo[..., c], normals, to_light, _EYE)
            for c in range(3)
        ],
        axis=-1,
    )
    points = np.stack([x, y, z], axis=-1)
    half = _PATCH // 2
    patch = (slice(half, None, _PATCH), slice(half, None, _PATCH))
    places, of = points[patch].reshape(-1, 3), normals[patch].reshape(-1, 3)
    kept = mask[patch].ravel()
    area = (_PATCH * step) ** 2 / of[:, 2]
    radiance = shading[..., None] * albedo
    for _ in range(_BOUNCES):
        light = np.moveaxis(radiance[(slice(None), *patch)], 0, 2).reshape(len(places), -1)
        more = np.zeros((*z.shape, lights * 3))
        of_kept = np.where(mask[..., None], normals, 0)
        _gathered(
            z, step, of_kept, points, of[kept], places[kept], area[kept],
            np.ascontiguousarray(light[kept]), more,
        )  # fmt: skip
        radiance = np.moveaxis(more.reshape(*z.shape, lights, 3), 2, 0) * albedo
        images += radiance
    return Figure(
        name, recorded(np.where(mask[..., None], images, 0), rng), directions, normals, mask
    )


def error_deg(found: NormalMap, one: Figure) -> float:
    """Return the mean error of a figure; a pixel without a normal counts 90 degrees."""
    angles = np.where(found.mask, angle_deg(found.normals, one.normals), 90.0)
    return float(angles[one.mask].mean())


def reconstructed(one: Figure) -> list[float]:
    """Return the errors of the reconstruction of images in files, by default and subtracted."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for k, image in enumerate(np.nan_to_num(one.values, nan=1.0)):
            levels = (65535 * np.clip(image, 0, 1)).round().astype(np.uint16)
            write_png(folder / f"figure.{k:03d}.png", levels)
        mask = folder / "mask.png"
        write_png(mask, np.where(one.mask, 255, 0).astype(np.uint8))
        source = read_source(folder, lights=Lights(one.directions), mask_path=mask)
        return [
            error_deg(reconstruct(source, surface=False, interreflection=on).normals, one)
            for on in (False, True)
        ]


def main() -> None:
    """Print one row for each figure."""
    parser = command_line(__doc__)
    parser.add_argument("--lights", type=int, default=96, help="number of lights")
    parser.add_argument("--seed", type=int, default=1, help="seed of figures and noise")
    parser.add_argument("--size", type=int, default=120, help="size of the figures, pixels")
    parser.add_argument("--out", type=Path, help="table of mean errors in degrees (.csv)")
    options = parser.parse_args()
    table = Table(options.out)
    for surface in ("glossy", "matte"):
        rows = []
        for name in ("bowl", "folds", "stones", "shell", "dented ball", "mean"):
            if name == "mean":
                errors = np.mean(rows, axis=0).tolist()
            else:
                size, lights = options.size, options.lights
                one = figure(name, options.seed, size, lights, glossy=surface == "glossy")
                gray = luma(one.values.astype(np.float32))
                solved = [
                    photometric_stereo(gray, Lights(one.directions), one.mask, method=method)
                    for method in METHODS
                ]
                errors = [error_deg(each.normal_map, one) for each in solved]
                rows.append(errors := errors + reconstructed(one))
            columns = (*METHODS, "default", "subtracted")
            row = {"figure": f"{surface} {name}"}
            table.add(row | {c: f"{e:.2f}" for c, e in zip(columns, errors, strict=True)})


if __name__ == "__main__":
    main()
