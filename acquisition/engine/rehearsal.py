"""A dry run: take every shot of a plan with all LEDs off and store nothing."""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import groupby

from acquisition._errors import DataError
from acquisition.plan.plan import CapturePlan
from acquisition.plan.planned_shot import PlannedShot
from rig import Progress, Rig, no_progress


def rehearse(
    rig: Rig,
    plan: CapturePlan,
    *,
    on_progress: Progress = no_progress,
    shots: Sequence[PlannedShot] | None = None,
) -> float:
    """Take every shot of a plan as a recording would, but with all LEDs off, and store nothing.

    Parameters
    ----------
    rig
        Open rig. It stays open, with all LEDs off.
    plan
        Plan to rehearse, without LEDs that are listed as dead.
    on_progress
        Receives the stage ``dry run``, one step per shot.
    shots
        If given, take only these shots of the plan.

    Returns
    -------
    float
        Duration of the shots in seconds, without writing, metering or retakes.

    Raises
    ------
    RigError
        If board or camera fail.
    DataError
        If a shot has no exposure.

    Examples
    --------
    >>> from acquisition import CapturePlan
    >>> from acquisition.engine import rehearse
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("coin", width=64, height=52, leds=4))
    >>> plan = CapturePlan(leds="0-3", exposures_us=(20_000.0,))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     seconds = rehearse(rig, plan)
    >>> 0 < seconds < 10
    True
    """
    began_s = time.monotonic()
    chosen = plan.shots() if shots is None else shots
    done = 0
    for exposure_us, alike in groupby(chosen, key=lambda shot: shot.exposure_us):
        if exposure_us is None:
            raise DataError("the plan gives no exposure")
        dark = [None for _ in alike]
        if plan.sequence and rig.config.trigger == "board":
            taken = rig.sequence(dark, exposure_us, plan.gain_db)
        else:
            taken = (rig.shoot(None, exposure_us, plan.gain_db) for _ in dark)
        for _ in taken:
            done += 1
            on_progress("dry run", done, len(chosen))
    return time.monotonic() - began_s
