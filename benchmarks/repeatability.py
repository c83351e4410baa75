"""How far recordings of one object differ, against the standard deviations that each one states.

One object of the simulator is recorded several times. Each recording has noise of its own, and a
calibration of its own: chrome spheres at other places, with noise. The normals come from
`processing.reconstruct`, the heights from `integrate` with their errors, as in `sgp run`. Printed
are the actual over the predicted deviation of the normals, in all and in deciles of the predicted
one, and that of differences in height along rows and columns at the distances that each result
states. The mean over the recordings stands for the truth, so that errors which all recordings have
in common do not count; the number of recordings is taken into account.

    python benchmarks/repeatability.py --recordings 30
"""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from harness import command_line
from light_accuracy import record
from sessions import write_session

from acquisition import Lights, read_source
from acquisition.plan import PlannedShot
from calibration import calibrate_spheres
from processing import integrate, reconstruct
from rig.arrays import Float32, Float64, UInt16
from simulator import ChromeSphere, Scene, render, scene_named
from simulator.camera import sensor_image

_RADIUS_MM, _EXPOSURE_US = 16.0, 20_000.0
_PLACES_MM = ((-60, -50), (65, -45), (-62, 48), (58, 52))


class Recorded(NamedTuple):
    """One recording's results."""

    normals: Float64
    sigma_deg: Float64
    height: Float64
    distances_px: tuple[int, ...]
    difference_sigma: tuple[float, ...]


def calibrated(scene: Scene, seed: int) -> Lights:
    """Return the lights from spheres at random places on the board, with the true strengths."""
    rng = np.random.default_rng([40, seed])
    places = np.array(_PLACES_MM) + rng.uniform(-12, 12, (len(_PLACES_MM), 2))
    spheres = tuple(ChromeSphere((x, y, _RADIUS_MM), _RADIUS_MM) for x, y in places.tolist())
    values, truth = record(replace(scene, spheres=spheres), seed)
    found = calibrate_spheres(values, camera=truth.camera, radius_mm=_RADIUS_MM).lights
    return replace(found, intensities=truth.lights.intensities)


def drawn(stated: Lights, truth: Lights, seed: int) -> Lights:
    """Return the true lights with errors that are drawn from the stated covariances."""
    rng = np.random.default_rng([41, seed])
    found = np.array(truth.positions_mm)
    for position, covariance in zip(found, stated.errors.covariances, strict=True):
        position += rng.multivariate_normal(np.zeros(3), covariance)
    return replace(stated, positions_mm=found)


def recorded_again(folder: Path, scene: Scene, planes: Float32, seed: int) -> None:
    """Record images of the object with the noise of a seed."""
    noise = scene.noise

    def frame(_: int, shot: PlannedShot) -> UInt16:
        lit = planes[shot.led] if shot.role == "light" else 0 * planes[0]
        electrons = (lit * shot.exposure_us).astype(np.float32)
        return sensor_image(electrons, noise, key=(seed, shot.led or 0, shot.role != "light"))

    write_session(
        folder,
        "repeated",
        frame,
        lights=len(planes),
        size=planes.shape[1:],
        exposures_us=(_EXPOSURE_US,),
        black_level_dn=noise.black_level_dn,
        bit_depth=noise.bit_depth,
        electrons_per_dn=noise.electrons_per_dn,
        read_noise_e=noise.read_noise_e,
    )


def results(folder: Path, scene: Scene, lights: Lights) -> Recorded:
    truth_camera = scene.lens.camera
    source = replace(read_source(folder, lights=lights), camera=truth_camera)
    found = reconstruct(source, surface=False)
    sigma = found.uncertainty.sigma_deg
    depth = None if found.near_height is None else found.near_height.depth
    surface = integrate(
        found.normals,
        camera=source.camera,
        depth_mm=depth,
        sigma_deg=sigma,
        common_sigma_deg=found.uncertainty.common_sigma_deg,
        weighted=False,
        height_errors=True,
    )
    stated = surface.uncertainty
    return Recorded(
        found.normals.normals.astype(np.float64),
        sigma.astype(np.float64),
        surface.height.astype(np.float64),
        tuple(stated.distances_px),
        tuple(stated.difference_sigma),
    )


def ratios(recorded: list[Recorded]) -> tuple[float, list[float]]:
    """Return actual over predicted deviations of the normals, in all and in deciles."""
    normals = np.stack([one.normals for one in recorded])
    sigma = np.stack([one.sigma_deg for one in recorded])
    mean = normals.mean(axis=0)
    mean /= np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-12)
    sine = np.linalg.norm(np.cross(normals, mean), axis=-1)
    actual = np.mean(np.degrees(np.arcsin(np.clip(sine, 0, 1))) ** 2, axis=0)
    actual *= len(recorded) / (len(recorded) - 1)
    known = np.isfinite(sigma).all(axis=0) & (np.abs(normals).sum(axis=-1) > 0).all(axis=0)
    predicted = np.mean(sigma[:, known] ** 2, axis=0)
    actual = actual[known]
    tenths = np.array_split(np.argsort(predicted), 10)
    share = [math.sqrt(actual[tenth].mean() / predicted[tenth].mean()) for tenth in tenths]
    return math.sqrt(actual.mean() / predicted.mean()), share


def height_ratio(recorded: list[Recorded], at: int) -> tuple[float, float]:
    """Return actual and predicted deviations of differences at one of the distances."""
    heights = np.stack([one.height for one in recorded])
    step = recorded[0].distances_px[at]
    across = heights[:, :, step:] - heights[:, :, :-step]
    down = heights[:, step:] - heights[:, :-step]
    variances = np.concatenate([np.var(one, axis=0, ddof=1).ravel() for one in (across, down)])
    actual = math.sqrt(np.nanmean(variances))
    predicted = math.sqrt(np.mean([one.difference_sigma[at] ** 2 for one in recorded]))
    return actual, predicted


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--recordings", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--scene", default="coin")
    parser.add_argument("--leds", type=int, default=12)
    parser.add_argument("--width", type=int, default=320, help="of the object, px")
    parser.add_argument("--drawn", action="store_true", help="errors of lights as they are stated")
    options = parser.parse_args()
    size = {"width": options.width, "height": options.width * 4 // 5, "leds": options.leds}
    scene = scene_named(options.scene, **size)
    spheres = scene_named("spheres", width=640, height=512, leds=options.leds)
    planes = render(scene).planes
    stated = calibrated(spheres, options.first) if options.drawn else None
    recorded = []
    start = time.process_time()
    for seed in range(options.first, options.first + options.recordings):
        if stated is None:
            lights = calibrated(spheres, seed)
        else:
            lights = drawn(stated, spheres.lights, seed)
        with tempfile.TemporaryDirectory(prefix="sgp-repeat-") as name:
            recorded_again(Path(name) / "session", scene, planes, seed)
            recorded.append(results(Path(name) / "session", scene, lights))
        print(f"recording {len(recorded)}: {time.process_time() - start:.0f} CPU s", flush=True)
    whole, tenths = ratios(recorded)
    print(f"normals, actual over predicted: {whole:.2f}")
    print("deciles: " + " ".join(f"{share:.2f}" for share in tenths))
    for at, distance in enumerate(recorded[0].distances_px):
        actual, predicted = height_ratio(recorded, at)
        print(
            f"height differences at {distance:3} px: {1e3 * actual:8.2f} um, predicted "
            f"{1e3 * predicted:8.2f}, ratio {actual / predicted:.2f}"
        )


if __name__ == "__main__":
    main()
