"""Scenes of the table, and random ones, as values of scene files."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.imperfections.real import data_folder
from benchmarks.imperfections.recordings import Recording, built

Table = dict[str, Any]
SIZE = (320, 256)

_LENS = {"kind": "perspective", "width": 480, "height": 384, "sharp": False}
_BOARD = {"kind": "even", "albedo": 0.05}
_ROUGH = {"kind": "oren-nayar", "sigma_deg": 15}
_PAINT = {"kind": "paint", "low": 0.3, "high": 0.7, "wavelength_mm": 40}


def _distant(count: int, seed: int) -> Table:
    """Return directions on rings of two elevations."""
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rise = np.radians(np.where(np.arange(count) % 2, 60, 35))
    out = np.cos(rise)
    rows = np.stack([out * np.cos(around), out * np.sin(around), np.sin(rise)], axis=1)
    strengths = np.random.default_rng(seed).normal(1, 0.03, count)
    return {"kind": "listed", "directions": rows.tolist(), "intensities": strengths.tolist()}


def _head() -> Table:
    file = data_folder() / "meshes" / "decimated-max.obj"
    return {"kind": "mesh", "file": str(file), "radius_mm": 70, "turn_deg": [0, 180, 0]}


SCENES: dict[str, Table] = {
    "leather": {
        "object": {"kind": "leather", "radius_mm": 85, "amplitude_mm": 2},
        "pattern": _PAINT,
        "material": _ROUGH,
    },
    "coin": {"object": {"kind": "coin", "radius_mm": 80}},
    "gloss": {
        "object": {"kind": "cap", "radius_mm": 75, "height_mm": 30},
        "pattern": _PAINT,
        "material": {"kind": "ggx", "roughness": 0.3},
    },
    "head": {"object": {}, "pattern": _PAINT, "material": _ROUGH},
    "textured": {
        "object": {"kind": "scales", "radius_mm": 80, "scale_mm": 20},
        "pattern": {"kind": "wood", "low": 0.15, "high": 0.6, "ring_mm": 14},
        "material": _ROUGH,
    },
    "few": {
        "object": {"kind": "coin", "radius_mm": 80, "dome_mm": 20, "relief_mm": 1.5},
        "pattern": _PAINT,
        "lights": {"kind": "dome", "count": 12},
    },
    "relief": {
        "object": {"kind": "noise", "radius_mm": 85, "rms_mm": 0.2, "wavelength_mm": 10},
        "pattern": _PAINT,
        "material": _ROUGH,
    },
    "colour": {
        "object": {"kind": "woodcarving", "radius_mm": 80},
        "pattern": {"kind": "colour-wheel", "low": 0.25},
        "material": _ROUGH,
        "lens": _LENS | {"cfa": "RGGB"},
    },
    "distant": {
        "object": {"kind": "cap", "radius_mm": 80, "height_mm": 25},
        "pattern": {"kind": "cork", "low": 0.3, "high": 0.6},
        "material": _ROUGH,
        "lights": _distant(24, 5),
    },
}


def scene(name: str, seed: int, size: tuple[int, int] = SIZE) -> Recording:
    """Record a scene of the table with other lights, other paint and other noise for each seed."""
    table = {"ambient": 0.002, "board": _BOARD, "lens": _LENS, "lights": {"kind": "dome"}}
    table |= SCENES[name]
    if name == "head":
        table |= {"object": _head()}
    return built(name, table, seed, size)


def random_scene(seed: int) -> Recording:
    """Record a random object of random paint under random lights."""
    rng = np.random.default_rng([seed, 39])

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    radius, slope = float(rng.uniform(55, 90)), float(rng.uniform(-0.2, 0.2))
    objects: list[Table] = [
        {"kind": "cap", "height_mm": radius * between(0.1, 0.9)},
        {"kind": "coin", "dome_mm": between(3, 30), "relief_mm": between(0.3, 2)},
        {"kind": "ripples", "amplitude_mm": between(0.2, 1), "wavelength_mm": between(8, 20)},
        {"kind": "scales", "amplitude_mm": between(0.8, 3), "scale_mm": between(10, 20)},
        {"kind": "textile", "amplitude_mm": between(0.5, 2), "yarn_mm": between(5, 12)},
        {"kind": "woodcarving", "amplitude_mm": between(1, 4)},
        {"kind": "leather", "amplitude_mm": between(0.6, 3), "plate_mm": between(12, 30)},
        {"kind": "noise", "rms_mm": between(0.05, 0.5), "wavelength_mm": between(6, 20)},
        {"kind": "plane", "height_mm": 1 + abs(slope) * radius, "slope_x": slope},
    ]
    meshes = ("decimated-max", "stanford-bunny", "skull")
    folder = data_folder() / "meshes"
    for mesh in meshes:
        turn = [float(v) for v in rng.choice([0, 90, 180], 3)]
        objects.append({"kind": "mesh", "file": str(folder / f"{mesh}.obj"), "turn_deg": turn})
    low, high = sorted(rng.uniform(0.1, 0.85, 2).tolist())
    shades = {"low": low, "high": max(high, low + 0.1)}
    patterns: list[Table] = [
        {"kind": "even", "albedo": high},
        {"kind": "paint", **shades, "wavelength_mm": between(20, 90)},
        {"kind": "checker", **shades, "square_mm": between(5, 25)},
        {"kind": "cork", **shades, "grain_mm": between(2, 8)},
        {"kind": "wood", **shades, "ring_mm": between(4, 15)},
        {"kind": "gradient", **shades},
    ]
    materials: list[Table] = [
        {"kind": "lambert"},
        {"kind": "oren-nayar", "sigma_deg": float(rng.uniform(5, 35))},
        {"kind": "ggx", "roughness": float(rng.uniform(0.15, 0.5))},
    ]
    count = int(rng.choice([6, 8, 12, 16, 24, 36]))
    ring = {"kind": "ring", "count": count, "elevation_deg": float(rng.uniform(30, 60))}
    lights: list[Table] = [{"kind": "dome", "count": count}] * 3 + [_distant(count, seed)] * 2
    lights.append(ring)
    sizes = [(200, 160), (320, 256), (480, 384)]

    def one(of: list[Any]) -> Any:
        return of[int(rng.integers(len(of)))]

    table = {
        "ambient": 0.002,
        "board": _BOARD,
        "object": one(objects) | {"radius_mm": radius},
        "pattern": one(patterns),
        "material": one(materials),
        "lights": one(lights),
        "lens": _LENS,
    }
    return built(f"random{seed}", table, seed, one(sizes))
