"""Detections and false alarms of the tests that images, lights and normals agree.

Each case is a recording with one planted mistake. A detection is a warning; a named one has the
code of the mistake. Scenes are the simulator's, and random objects under random distant lights with
gloss and ambient light.

    python benchmarks/quality_warnings.py --trials 10

Each part has its own random numbers; with one trial and ten objects all parts take about twenty
minutes of CPU time. ``height_warnings.py`` counts what shows only when the height under near lights
is found.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from acquisition import Lights
from processing import photometric_stereo
from processing.checks import image_quality
from rig.arrays import Bool, Float32, Float64
from simulator import SCENES, render, scene_named

MIRROR_X = np.array([-1.0, 1.0, 1.0])


class Recording(NamedTuple):
    values: Float32
    lights: Lights
    mask: Bool
    points_mm: Float64 | None


Mistake = Callable[[Recording, np.random.Generator], Recording]


def simulated(name: str, leds: int, rng: np.random.Generator) -> Recording:
    """Render a scene of the simulator with photon noise; its points are where the surface is."""
    rendering = render(scene_named(name, width=240, height=200, leds=leds))
    truth = rendering.truth
    planes = rendering.planes if rendering.planes.ndim == 3 else rendering.planes.mean(axis=-1)
    full = np.quantile(planes[:, truth.mask], 0.999) / 0.8
    values = rng.poisson(np.clip(planes / full, 0, 1) * 1e4) / 1e4
    values = np.where(values >= 1, np.nan, values).astype(np.float32)
    return Recording(values, truth.lights, truth.mask, truth.points_mm)


def random_object(leds: int, rng: np.random.Generator) -> Recording:
    """Shade a random surface with random albedo, gloss and ambient light under random lights."""
    size = 160
    rows, columns = np.mgrid[:size, :size]
    x, y = (columns - 80) / 70, (80 - rows) / 70
    mask = x**2 + y**2 < 1
    height = rng.uniform(0.1, 0.8) * np.sqrt(np.clip(1.1 - x**2 - y**2, 0, 1))
    for scale in (4, 12):
        waves = gaussian_filter(rng.normal(size=(size, size)), scale)
        height += rng.uniform(0.02, 0.1) * scale / 12 * waves / waves.std()
    down, right = np.gradient(height, 1 / 70)
    normals = np.dstack([-right, down, np.ones_like(height)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    around = rng.uniform(0, 2 * np.pi, leds)
    up = np.cos(np.radians(rng.uniform(15, 60, leds)))
    out = np.sqrt(1 - up**2)
    directions = np.stack([out * np.cos(around), out * np.sin(around), up], 1)
    albedo = np.exp(gaussian_filter(rng.normal(size=(size, size)), 6) * 6)
    halves = directions + np.array([0, 0, 1])
    halves /= np.linalg.norm(halves, axis=1, keepdims=True)
    cosine = np.clip(np.einsum("hwc,nc->nhw", normals, directions), 0, None)
    shine = np.clip(np.einsum("hwc,nc->nhw", normals, halves), 0, None) ** rng.uniform(8, 60)
    light = albedo * (cosine + rng.uniform(0, 0.03)) + rng.uniform(0, 0.6) * shine * (cosine > 0)
    light /= np.quantile(light[:, mask], 0.999) / 0.9
    values = rng.poisson(np.clip(light, 0, 1) * 4000) / 4000
    values = np.where(values >= 1, np.nan, values).astype(np.float32)
    return Recording(values, Lights(directions=directions), mask, None)


def _shuffled(r: Recording, rng: np.random.Generator) -> Recording:
    return r._replace(lights=r.lights.take([int(i) for i in rng.permutation(len(r.lights))]))


def _swapped(r: Recording, rng: np.random.Generator) -> Recording:
    order = list(range(len(r.lights)))
    i, j = rng.choice(len(order), 2, replace=False)
    order[i], order[j] = order[j], order[i]
    return r._replace(lights=r.lights.take([int(k) for k in order]))


def _mirrored(r: Recording, _: np.random.Generator) -> Recording:
    if r.lights.positions_mm is not None:
        changed = replace(r.lights, positions_mm=r.lights.positions_mm * MIRROR_X, axes=None)
    else:
        changed = replace(r.lights, directions=r.lights.unit_directions * MIRROR_X, axes=None)
    return r._replace(lights=changed)


def _doubled(r: Recording, rng: np.random.Generator) -> Recording:
    values = r.values.copy()
    i, j = rng.choice(len(values), 2, replace=False)
    values[i] = values[j]
    return r._replace(values=values)


def _turned(r: Recording, rng: np.random.Generator) -> Recording:
    values = r.values.copy()
    i = rng.integers(len(values))
    values[i] = values[i, ::-1, ::-1]
    return r._replace(values=values)


def _brighter(factor: float) -> Mistake:
    """Return a wrong exposure of one image."""

    def plant(r: Recording, rng: np.random.Generator) -> Recording:
        values = r.values.copy()
        values[rng.integers(len(values))] *= factor
        return r._replace(values=values)

    return plant


def _moved(degrees: float) -> Mistake:
    return lambda r, rng: _with_light_moved(r, rng, degrees)


def _with_light_moved(r: Recording, rng: np.random.Generator, degrees: float) -> Recording:
    """Turn one light about the axis of the camera or toward it."""
    lights = r.lights
    i = int(rng.integers(len(lights)))
    vectors = (
        lights.unit_directions if lights.positions_mm is None else lights.positions_mm
    ).copy()
    angle = np.radians(degrees)
    axis = np.cross(vectors[i], [0, 0, 1.0])
    axis /= max(np.linalg.norm(axis), 1e-9)
    vectors[i] = vectors[i] * np.cos(angle) + np.cross(axis, vectors[i]) * np.sin(angle)
    key = "directions" if lights.positions_mm is None else "positions_mm"
    return r._replace(lights=replace(lights, **{key: vectors}, axes=None))


def _torn(r: Recording, rng: np.random.Generator) -> Recording:
    """Replace a tenth of the rows of the object in one image by those of another one."""
    values = r.values.copy()
    i, j = rng.choice(len(values), 2, replace=False)
    rows = np.flatnonzero(r.mask.any(axis=1))
    first = int(rng.integers(rows[0], rows[-1] - len(rows) // 10))
    torn = slice(first, first + len(rows) // 10)
    values[i, torn] = 2 * values[j, torn]
    return r._replace(values=values)


def _clipped(r: Recording, rng: np.random.Generator) -> Recording:
    """Clip the brightest 30 % of one image."""
    values = r.values.copy()
    i = rng.integers(len(values))
    values[i] = np.fmin(values[i], np.nanquantile(values[i, r.mask], 0.7))
    return r._replace(values=values)


def _noise(r: Recording, rng: np.random.Generator) -> Recording:
    values = r.values.copy()
    i = rng.integers(len(values))
    values[i, r.mask] = rng.permutation(values[i, r.mask])
    return r._replace(values=values)


def _shifted(r: Recording, rng: np.random.Generator) -> Recording:
    values = r.values.copy()
    i = rng.integers(len(values))
    values[i] = np.roll(values[i], (3, -3), axis=(0, 1))
    return r._replace(values=values)


def _scattered(r: Recording, rng: np.random.Generator) -> Recording:
    """Change the brightness of half of the images."""
    values = r.values.copy()
    wrong = rng.choice(len(values), len(values) // 2, replace=False)
    values[wrong] *= rng.uniform(0.6, 1.6, (len(wrong), 1, 1)).astype(np.float32)
    return r._replace(values=values)


MISTAKES: dict[str, tuple[Mistake, tuple[str, ...]]] = {
    "shuffled": (_shuffled, ("lights-shuffled", "images-swapped")),
    "two swapped": (_swapped, ("images-swapped",)),
    "mirrored": (_mirrored, ("lights-mirrored",)),
    "one doubled": (_doubled, ("image-duplicate",)),
    "one turned": (_turned, ("image-turned", "image-disagrees")),
    "one .6 times": (_brighter(0.6), ("light-brightness",)),
    "one 1.15 times": (_brighter(1.15), ("light-brightness",)),
    "one 25 deg off": (_moved(25), ("light-moved", "image-disagrees")),
    "one 10 deg off": (_moved(10), ("light-moved", "image-disagrees")),
    "one clipped": (_clipped, ("image-clipped",)),
    "rows of another": (_torn, ("image-striped",)),
    "one is noise": (_noise, ("image-disagrees",)),
    "one shifted 3 px": (_shifted, ("image-shifted",)),
    "half scattered": (_scattered, ("images-undecided",)),
}


def _table(
    title: str,
    recordings: list[Recording],
    trials: int,
    rng: np.random.Generator,
) -> None:
    alarms = sum(bool(image_quality(*r[:3], points_mm=r.points_mm).warnings) for r in recordings)
    print(f"{title:<34}{'correct':<18}{alarms:>4} false alarms in {len(recordings)}")
    for name, (mistake, codes) in MISTAKES.items():
        found = named = total = 0
        for recording in recordings:
            for _ in range(trials):
                wrong = mistake(recording, rng)
                warnings = image_quality(*wrong[:3], points_mm=wrong.points_mm).warnings
                found += bool(warnings)
                named += any(notice.code in codes for notice in warnings)
                total += 1
        print(f"{'':<34}{name:<18}{found:>4} found, {named:>4} named, of {total}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--objects", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--parts", nargs="+", choices=tuple(_PARTS), default=tuple(_PARTS))
    options = parser.parse_args()
    for name in options.parts:
        _PARTS[name](options, np.random.default_rng([options.seed, *map(ord, name)]))


def _scenes(options: argparse.Namespace, rng: np.random.Generator) -> None:
    flat = ("plane", "tilted-plane", "white-plane", "charuco", "step-gauge")
    curved = sorted(set(SCENES) - {"spheres", *flat})
    for leds in (8, 12, 36):
        scenes = [simulated(name, leds, rng) for name in curved]
        _table(f"{len(curved)} curved scenes, {leds} lights", scenes, options.trials, rng)
    scenes = [simulated(name, 12, rng) for name in flat]
    _table(f"{len(flat)} flat scenes, 12 lights", scenes, options.trials, rng)


def _objects(options: argparse.Namespace, rng: np.random.Generator) -> None:
    for leds in (6, 8, 12, 36):
        objects = [random_object(leds, rng) for _ in range(options.objects)]
        _table(f"{options.objects} random objects, {leds} lights", objects, options.trials, rng)


def _cost(_: argparse.Namespace, rng: np.random.Generator) -> None:
    large = simulated("coin", 12, rng)
    large = Recording(
        np.repeat(np.repeat(large.values, 8, 1), 8, 2),
        Lights(directions=large.lights.unit_directions),
        np.repeat(np.repeat(large.mask, 8, 0), 8, 1),
        None,
    )
    start = time.process_time()
    image_quality(*large[:3])
    middle = time.process_time()
    photometric_stereo(*large[:3])
    end = time.process_time()
    print(
        f"{large.mask.size / 1e6:.1f} Mpx, 12 images: tests {middle - start:.2f} CPU s, "
        f"normals {end - middle:.2f} CPU s"
    )


_PARTS = {"scenes": _scenes, "objects": _objects, "cost": _cost}


if __name__ == "__main__":
    main()
