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

Rendered = simulator.Rendering | simulator.StoredRendering

# Share of the sensor's range that a metered exposure fills; the rest is for noise and flicker.
_FILL = 0.8
_METERED_PIXELS = 100_000
_EXPOSURE_RANGE_US = (10.0, 1_000_000.0)


def metered_exposures(rendering: Rendered) -> tuple[float, ...]:
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
    size = rendering.scene.lens.size
    mask, spheres = np.zeros(size, np.bool_), np.zeros(size, np.bool_)
    for band in rendering.bands():
        rows = slice(band.truth.top, band.truth.top + len(band.truth.mask))
        mask[rows] = band.truth.mask
        spheres[rows] = np.any(band.truth.sphere_masks, axis=0)
    matte = mask if mask.any() else ~spheres
    exposures = [_exposure_us(rendering, _brightest(rendering, matte, 0.999))]
    if spheres.any():
        exposures.append(_exposure_us(rendering, _brightest(rendering, spheres, 1.0)))
    return tuple(sorted(set(exposures), reverse=True))


def _brightest(rendering: Rendered, where: npt.NDArray[np.bool_], quantile: float) -> float:
    """Return the largest quantile over all lights of the signal, in photons per microsecond."""
    places = np.flatnonzero(where)
    if quantile < 1:
        places = places[:: -(-len(places) // _METERED_PIXELS)]
    found = []
    for band in rendering.bands():
        first, count = band.truth.top * where.shape[1], band.ambient.size
        begin, end = np.searchsorted(places, (first, first + count))
        picked = places[begin:end] - first
        values = band.planes.reshape(len(band.planes), -1)[:, picked]
        # Only one value of each light matters if no quantile is asked for.
        if quantile == 1 and len(picked):
            values = values.max(axis=1, keepdims=True)
        found.append(values)
    return float(np.quantile(np.concatenate(found, axis=1), quantile, axis=1).max())


def _exposure_us(rendering: Rendered, photons_per_us: float) -> float:
    noise = rendering.scene.noise
    electrons_per_us = photons_per_us * noise.quantum_efficiency
    full = (noise.white_level_dn - noise.black_level_dn) * noise.electrons_per_dn
    low, high = _EXPOSURE_RANGE_US
    exposure = min(max(_FILL * full / max(electrons_per_us, 1e-9), low), high)
    digit = 10.0 ** (math.floor(math.log10(exposure)) - 1)
    return max(math.floor(exposure / digit) * digit, low)


def record_simulated(
    rendering: Rendered,
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
    scene = rendering.scene
    given = acquisition.Calibrations(camera_model=scene.lens.camera, sensor=scene.noise)
    leds = len(scene.lights)
    dead = tuple(led for led in scene.lamps.dead if led < leds)  # the rig refuses others
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
            calibrations=acquisition.Calibrations(
                camera_model=scene.lens.camera, sensor=scene.noise
            ),
            hooks=acquisition.RecordingHooks(on_progress=progress),
        )
