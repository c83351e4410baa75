"""Tasks of a station besides recordings: metering, checks, a quick look at normals."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, sqrt
from pathlib import Path
from typing import Any, Final

import numpy as np

import acquisition
import rig as rigs
from rig.arrays import UInt8
from sgp.cli.options import RIG_LIGHTS, RemedyOptions, SourceOptions
from sgp.results import good_result
from sgp.results.verdict import verdict_line
from sgp.screen.desk import Desk

Task = Callable[[rigs.Rig, Desk], None]

# Enough to see faults of the lights, and few enough for seconds.
_LOOK_PIXELS: Final = 150_000


def meter(*, each: bool) -> Task:
    """Return a task that meters the exposure times of the plan."""

    def task(rig: rigs.Rig, desk: Desk) -> None:
        goal = acquisition.metering.MeteringGoal(each=each)
        metered = acquisition.metering.meter(rig, desk.sheet.plan, goal, on_progress=desk.progress)
        desk.sheet.put(metered.plan)
        lights = [
            {
                "led": light.led,
                "exposure_us": light.exposure_us,
                "level": light.level,
                "state": light.state,
            }
            for light in metered.lights
        ]
        desk.show(metered=lights, notices=[noticed(one) for one in metered.warnings])

    return task


def check(folder: Path) -> Task:
    """Return a task that checks disk, rig and picture for a recording into a folder."""

    def task(rig: rigs.Rig, desk: Desk) -> None:
        desk.show(checks=None)
        flight = acquisition.preflights.preflight(
            rig, desk.sheet.plan, folder, on_progress=desk.progress
        )
        desk.show(
            checks=[
                {"name": one.name, "state": one.state, "lines": list(one.lines)}
                for one in flight.checks
            ]
        )

    return task


def look(folder: Path, pixel_mm: float | None, keep: Callable[[UInt8], None]) -> Task:
    """Return a task that computes normals of a session at a reduced size.

    Parameters
    ----------
    folder
        The session.
    pixel_mm
        Size of a pixel on the object; without it and a camera with a working distance, the lights
        count as distant.
    keep
        Receives the picture of the normals.
    """

    def task(rig: rigs.Rig, desk: Desk) -> None:
        # Imported here because the estimators take a while to import.
        from sgp.stages import compute_normals, open_recording, with_scale

        desk.progress("reading the session", 0, 1)
        session = acquisition.Session.open(folder)
        height, width = session.frames[0].read().shape[:2]
        lights = None if session.lights is not None else RIG_LIGHTS
        if lights is not None and not rig.config.led_positions_mm:
            raise acquisition.DataError(
                "normals need lights: give calibrated ones with --lights, or write "
                "led_positions_mm into the rig file"
            )
        reduced = max(1, ceil(sqrt(height * width / _LOOK_PIXELS)))
        camera = session.camera_model
        scaled = pixel_mm or (camera is not None and camera.working_distance_mm)
        options = RemedyOptions(lights=lights, downscale=reduced, distant=not scaled)
        source, pixel = with_scale(open_recording(folder, options).source, pixel_mm)
        desk.progress("computing normals", 0, 1)
        made = compute_normals(source, SourceOptions(**vars(options)).stage(pixel))
        shades = np.where(made.mask[..., None], made.normals.normals / 2 + 0.5, 1.0)
        keep(np.rint(255 * np.clip(shades, 0, 1)).astype(np.uint8))
        verdict = verdict_line(made.verdict, good_result(made.verdict))
        desk.show(look={"verdict": verdict, "folder": str(folder)})

    return task


def noticed(notice: rigs.Notice) -> dict[str, Any]:
    """Return a notice in JSON types."""
    return {"severity": notice.label, "text": str(notice)}
