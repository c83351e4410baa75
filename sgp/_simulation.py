"""Record a rendered scene as an operator would, with metered exposure times."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

import acquisition
import rig as rigs
import simulator
from sgp._console import Stages

# Share of the sensor's range that a metered exposure fills; the rest is for noise and flicker.
_FILL = 0.8
_METERED_PIXELS = 100_000
_EXPOSURE_RANGE_US = (10.0, 1_000_000.0)


def metered_exposures(rendering: simulator.Rendering) -> tuple[float, ...]:
    """Choose exposure times: one for matte surfaces, a short one for highlights on spheres.

    Parameters
    ----------
    rendering
        The rendered scene.

    Returns
    -------
    tuple of float
        Exposure times in µs, rounded to two digits, longest first; only one if no sphere is in
        view.
    """
    truth = rendering.truth
    spheres: npt.NDArray[np.bool_] = np.any(truth.sphere_masks, axis=0)
    matte = truth.mask if truth.mask.any() else ~spheres
    exposures = [_exposure_us(rendering, _brightest(rendering.planes, matte, 0.999))]
    if spheres.any():
        exposures.append(_exposure_us(rendering, _brightest(rendering.planes, spheres, 1.0)))
    return tuple(sorted(set(exposures), reverse=True))


def _brightest(
    planes: npt.NDArray[np.float32], where: npt.NDArray[np.bool_], quantile: float
) -> float:
    """Return the largest quantile over all lights of the signal, in photons per microsecond."""
    places = np.flatnonzero(where)
    if quantile < 1:
        places = places[:: -(-len(places) // _METERED_PIXELS)]
    return max(float(np.quantile(plane.ravel()[places], quantile)) for plane in planes)


def _exposure_us(rendering: simulator.Rendering, photons_per_us: float) -> float:
    noise = rendering.truth.noise
    electrons_per_us = photons_per_us * noise.quantum_efficiency
    full = (noise.white_level_dn - noise.black_level_dn) * noise.electrons_per_dn
    low, high = _EXPOSURE_RANGE_US
    exposure = min(max(_FILL * full / max(electrons_per_us, 1e-9), low), high)
    digit = 10.0 ** (math.floor(math.log10(exposure)) - 1)
    return max(math.floor(exposure / digit) * digit, low)


def record_simulated(
    rendering: simulator.Rendering,
    out: Path,
    *,
    exposures_us: tuple[float, ...],
    object_name: str,
    seed: int,
    noisy: bool,
) -> acquisition.Session:
    """Record a rendering with the simulated rig, without waiting for the exposure times.

    The plan skips the scene's dead LEDs, as an operator would list them in the rig file.

    Raises
    ------
    RigError, DataError, StorageError
        As for `acquisition.record`; the frames recorded before the error stay intact.
    """
    truth = rendering.truth
    leds = len(rendering.planes)
    dead = tuple(led for led in rendering.scene.lamps.dead if led < leds)  # the rig refuses others
    config = rigs.RigConfig(name="simulated", driver="simulated", leds=leds, dead_leds=dead)
    plan = acquisition.CapturePlan(leds=tuple(range(leds)), exposures_us=exposures_us)
    with (
        simulator.open_rig_seeing(rendering, config, seed=seed, noisy=noisy, realtime=False) as rig,
        Stages() as progress,
    ):
        return acquisition.record(
            rig,
            plan,
            out,
            acquisition.Labels(operator="sgp simulate", object_name=object_name),
            calibrations=acquisition.Calibrations(camera_model=truth.camera, sensor=truth.noise),
            hooks=acquisition.RecordingHooks(on_progress=progress),
        )
