"""Record a rendered scene as an operator would, with metered exposure times."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

import acquisition
import rig as rigs
import simulator
from rig.arrays import Bool, Float32, Int64
from sgp.cli.console import Stages

Rendered = simulator.Rendering | simulator.rendering.StoredRendering

# Share of the sensor's range that a metered exposure fills; the rest is for noise and flicker.
_FILL = 0.8
_METERED_PIXELS = 100_000
_BAND_BYTES = 2**26
# How long the computation of a frame may take: usually 50 ns per pixel.
_FRAME_S, _S_PER_PIXEL, _LONGEST_FRAME_S = 2.0, 5e-7, 60.0
_EXPOSURE_RANGE_US = (10.0, 1_000_000.0)


@contextmanager
def rendered(scene: simulator.Scene, folder: Path, memory: int | None) -> Iterator[Rendered]:
    """Render a scene: in memory if it fits, otherwise on the disk of ``folder``.

    Parameters
    ----------
    scene
        Scene to render.
    folder
        Folder for temporary files; created if it is needed.
    memory
        Bytes to use; None for half of what is free.
    """
    budget = rigs.processes.memory_budget(memory)
    with ExitStack() as kept:
        rendering: Rendered
        with Stages() as progress:
            if simulator.rendering.rendering_bytes(scene) <= budget:
                rendering = simulator.render(scene, progress)
            else:
                acquisition.make_folder(folder)
                rendering = kept.enter_context(
                    simulator.rendering.render_stored(
                        scene, folder, memory_bytes=budget, on_progress=progress
                    )
                )
        yield rendering


def pixels_in_view(rendering: Rendered) -> dict[str, int]:
    """Return the number of pixels of the object, ``mask``, and of spheres, if they are in view."""
    counts = {
        name: int(mask[:].sum())
        for name, mask in rendering.maps.items()
        if name == "mask" or name.startswith("sphere_")
    }
    return {name: count for name, count in counts.items() if count}


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
    maps = rendering.maps
    spheres = np.zeros(rendering.scene.lens.size, np.bool_)
    for index in range(len(rendering.scene.spheres)):
        spheres |= maps[f"sphere_{index}"][:]
    mask = maps["mask"][:]
    matte = mask if mask.any() else ~spheres
    exposures = [_exposure_us(rendering, _brightest(rendering, matte, 0.999))]
    if spheres.any():
        exposures.append(_exposure_us(rendering, _brightest(rendering, spheres, 1.0)))
    return tuple(sorted(set(exposures), reverse=True))


def _brightest(rendering: Rendered, where: Bool, quantile: float) -> float:
    """Return the largest quantile over all lights of the signal, in photons per microsecond."""
    places = np.flatnonzero(where)
    if quantile < 1:
        places = places[:: -(-len(places) // _METERED_PIXELS)]
    lights = range(len(rendering.scene.lights))
    return max(float(np.quantile(_at(rendering.plane(led), places), quantile)) for led in lights)


def _at(plane: acquisition.MapRows, places: Int64) -> Float32:
    """Return the values at indices, in order, of all pixels."""
    height, width = plane.shape
    found = []
    for rows in acquisition.files.rows_in_bands(height, 4 * width, _BAND_BYTES):
        first = rows.start * width
        inside = slice(*np.searchsorted(places, (first, rows.stop * width)))
        found.append(plane[rows].ravel()[places[inside] - first])
    return np.concatenate(found)


def _exposure_us(rendering: Rendered, photons_per_us: float) -> float:
    noise = rendering.truth_of(slice(0, 1)).noise
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
    # This process computes a frame while the board waits for it.
    height, width = scene.lens.size
    timeout_s = min(max(_FRAME_S, _S_PER_PIXEL * height * width), _LONGEST_FRAME_S)
    config = rigs.RigConfig(
        name="simulated", driver="simulated", leds=leds, dead_leds=dead, frame_timeout_s=timeout_s
    )
    # Nothing moves or fades between the frames of a rendering.
    plan = acquisition.CapturePlan(leds=tuple(range(leds)), exposures_us=exposures_us, repeat=False)
    with (
        simulator.open_rig_seeing(rendering, config, seed=seed, noisy=noisy, realtime=False) as rig,
        Stages() as progress,
    ):
        return acquisition.record(
            rig,
            plan,
            out,
            acquisition.Labels(operator="sgp simulate", object_name=object_name),
            calibrations=given,
            hooks=acquisition.RecordingHooks(on_progress=progress),
        )
