"""Actual over predicted errors of normals, in deciles of the predicted standard deviation.

Pixels are sorted by ``normal_sigma_deg`` and split into ten parts; each part has the root mean
square of the actual angles over that of the predicted ones. The smallest and the largest of the ten
are printed, for known and unknown noise. Scenes are Lambertian: a ball under distant lights with
attached shadows, the same with cast shadows, and reliefs of the simulator under near lights, with
cast shadows and true points. "light errors" are drawn from the stated covariances, once for each
of many repetitions, because they are common to all pixels. Rows on glossy surfaces show how much of
an error that no model of noise contains is still predicted.

    python benchmarks/normal_uncertainty.py --seed 1
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from harness import command_line

from acquisition import LightErrors, Lights, angle_deg
from acquisition.values import tangent_basis
from calibration import StackNoise
from processing import Method, photometric_stereo
from processing.noise import NormalUncertainty, normal_uncertainty
from processing.stereo import METHODS
from rig.arrays import Bool, Float64
from simulator import render, scene_named
from simulator.scene import Ggx
from simulator.scene.reflectance import reflectance

# Variance per value and without light, where white is 1: 10 000 electrons at white, 5 read noise.
SLOPE, FLOOR = 1e-4, 2.5e-7
_EYE = np.array([0.0, 0.0, 1.0])
# Standard deviations of the lights in the rows with light errors.
_DIRECTION_RAD, _POSITION_MM, _INTENSITY = 0.01, 3.0, 0.01


@dataclass(frozen=True, eq=False)
class Case:
    """Images ``(N, H, W)`` without noise, and what they are of."""

    images: Float64
    lights: Lights
    normals: Float64
    mask: Bool
    points_mm: Float64 | None = None
    shadows: Bool | None = None


def dome(count: int, lowest: float = 0.35) -> Lights:
    """Return distant lights that are spread over a dome by the golden angle."""
    z = np.linspace(0.98, lowest, count)
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return Lights(np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1))


def ball(
    rng: np.random.Generator, *, size: int, count: int, cast: bool, gloss: float | None = None
) -> Case:
    """Return a ball with an albedo from 0.1 to 0.9; a third of the lights may be blocked."""
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j]
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, None))
    normals, mask = np.stack([x, y, z], axis=-1), np.hypot(x, y) < 0.95
    lights = dome(count)
    vectors = lights.unit_directions
    shading = np.clip(np.einsum("nc,hwc->nhw", vectors, normals), 0, None)
    albedo = 0.5 + 0.4 * np.sin(7 * x + rng.uniform(0, 6)) * np.cos(6 * y + rng.uniform(0, 6))
    if gloss is None:
        images = albedo * shading
    else:
        brdf = reflectance(Ggx(gloss, 0.04), 0.5, normals, vectors[:, None, None], _EYE)
        images = shading * brdf / np.quantile(shading * brdf, 0.995)
    shadows = shading <= 0
    if cast:
        turn, most = rng.uniform(0, 2 * np.pi, x.shape), rng.uniform(0, 0.33, x.shape)
        side = np.einsum("nc,chw->nhw", vectors[:, :2], np.stack([np.cos(turn), np.sin(turn)]))
        ranks = side.argsort(axis=0).argsort(axis=0)
        blocked = ranks < most * len(vectors)
        images = np.where(blocked, 0, images)
        shadows |= blocked
    return Case(images, lights, normals, mask, shadows=shadows)


def relief(name: str, *, width: int, seed: int, count: int = 36, sharp: bool = True) -> Case:
    """Return a scene of the simulator under near lights."""
    size = {"width": width, "height": width * 4 // 5}
    scene = scene_named(name, **size, leds=count, seed=seed, sharp=sharp)
    rendering = render(scene)
    truth = rendering.truth
    strength = np.asarray(truth.lights.intensities).mean(axis=1)[:, None, None]
    images = rendering.planes / strength
    return Case(
        0.9 * images.astype(np.float64) / np.quantile(images[:, truth.mask], 0.999),
        replace(truth.lights, intensities=None),
        truth.normals.astype(np.float64),
        truth.mask,
        truth.points_mm,
        truth.shadows,
    )


def misplaced(lights: Lights, rng: np.random.Generator) -> tuple[Lights, Float64]:
    """Return lights with errors that they state, and the factors of their intensities."""
    count = len(lights)
    factor = 1 + _INTENSITY * rng.normal(size=count)
    if lights.positions_mm is None:
        basis = tangent_basis(lights.unit_directions)
        shift = np.einsum("nk,nkc->nc", _DIRECTION_RAD * rng.normal(size=(count, 2)), basis)
        errors = LightErrors(
            np.tile(_DIRECTION_RAD**2 * np.eye(2), (count, 1, 1)), np.full(count, _INTENSITY)
        )
        return Lights(lights.unit_directions + shift, errors=errors), factor
    # Twice as far along the light as across it.
    spread = np.linalg.norm(lights.positions_mm, axis=1)
    along = lights.positions_mm / spread[:, None]
    shape = np.eye(3) + np.einsum("ni,nj->nij", along, along)
    shift = _POSITION_MM * np.einsum("nij,nj->ni", shape, rng.normal(size=(count, 3)))
    errors = LightErrors(
        _POSITION_MM**2 * shape @ shape.transpose(0, 2, 1), np.full(count, _INTENSITY)
    )
    moved = lights.positions_mm + shift
    return replace(lights, positions_mm=moved, errors=errors), factor


def recorded(case: Case, factor: Float64, rng: np.random.Generator) -> Float64:
    """Return images with noise; saturated samples are NaN."""
    images = case.images * factor[:, None, None]
    noisy = images + rng.normal(size=images.shape) * np.sqrt(FLOOR + SLOPE * images)
    return np.where(noisy < 1, noisy, np.nan)


def cases(seed: int, size: int, count: int) -> Iterator[tuple[str, bool, int, list[Case]]]:
    """Yield name, whether lights have errors, repetitions, and scenes of each row."""
    rng = np.random.default_rng(seed)
    make = partial(ball, rng, count=count)
    yield "distant", False, 3, [make(size=size, cast=False)]
    yield "distant, cast shadows", False, 3, [make(size=size, cast=True)]
    yield "distant, light errors", True, 30, [make(size=size // 2, cast=True)]
    for name in ("coin", "sphere", "woodcarving"):
        yield f"near, {name}", False, 2, [relief(name, width=2 * size, seed=seed, count=count)]
    sphere = [relief("sphere", width=size, seed=seed, count=count)]
    yield "near, sphere, light errors", True, 30, sphere
    yield "glossy, GGX 0.3", False, 2, [make(size=size, cast=False, gloss=0.3)]
    yield "glossy, GGX 0.15", False, 2, [make(size=size, cast=False, gloss=0.15)]


def ratios(actual: Float64, predicted: Float64) -> Float64:
    """Return actual over predicted, both root mean square, in ten parts by the predicted one."""
    order = np.argsort(predicted)
    return np.array(
        [
            np.sqrt(np.mean(actual[part] ** 2) / np.mean(predicted[part] ** 2))
            for part in np.array_split(order, 10)
        ]
    )


def solved(
    case: Case, method: Method, known: bool, errors: bool, rng: np.random.Generator
) -> tuple[Float64, NormalUncertainty]:
    """Return the angular errors ``(H, W)`` and the error bars of one recording."""
    lights, factor = case.lights, np.ones(len(case.lights))
    if errors:
        lights, factor = misplaced(lights, rng)
    values = recorded(case, factor, rng)
    noise = StackNoise.of_one_exposure(SLOPE, FLOOR, len(values)) if known else None
    points_mm, mask = case.points_mm, case.mask
    stereo = photometric_stereo(
        values, lights, mask, method=method, points_mm=points_mm, noise=noise
    )
    bars = normal_uncertainty(values, lights, mask, stereo, points_mm=points_mm, noise=noise)
    return angle_deg(stereo.normal_map.normals, case.normals), bars


def main() -> None:
    """Print one row for each scene and method."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=1, help="seed of scenes, noise and lights")
    parser.add_argument("--size", type=int, default=100, help="size of the scenes, pixels")
    parser.add_argument("--lights", type=int, default=36, help="number of lights")
    parser.add_argument("--rows", type=int, default=9, help="number of rows, from the first on")
    options = parser.parse_args()
    head = "actual / predicted, lowest and highest decile"
    print(f"{head:46} known          unknown    rms deg, predicted", flush=True)
    rows = islice(cases(options.seed, options.size, options.lights), options.rows)
    for name, errors, repeats, scenes in rows:
        for method in METHODS:
            row, rms = [], []
            for known in (True, False):
                actual, predicted = [], []
                rng = np.random.default_rng([options.seed, len(name)])
                for case in scenes * repeats:
                    angles, bars = solved(case, method, known, errors, rng)
                    actual.append(angles[bars.valid])
                    predicted.append(bars.sigma_deg[bars.valid])
                of_all, sigmas = np.concatenate(actual), np.concatenate(predicted).astype(float)
                found = ratios(of_all, sigmas)
                row.append(f"{found.min():6.2f} {found.max():5.2f}")
                rms.append(f"{np.sqrt(np.mean(of_all**2)):7.3f} {np.sqrt(np.mean(sigmas**2)):6.3f}")
            print(f"{name:30} {method:12} {row[0]}   {row[1]}   {rms[0]} {rms[1]}", flush=True)


if __name__ == "__main__":
    main()
