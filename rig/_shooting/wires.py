"""Test with one flash whether board and camera are wired to each other."""

from __future__ import annotations

import time
from dataclasses import dataclass

from rig._errors import FrameTimeoutError
from rig._shooting.shooting import Bench
from rig._shooting.shot_times import ShotTimes


@dataclass(frozen=True)
class Wires:
    """Which signals arrive between board and camera.

    Parameters
    ----------
    trigger
        Whether the board's trigger pulse makes the camera expose.
    exposure_active
        Whether the camera's exposure-active output reaches the board.
    """

    trigger: bool
    exposure_active: bool


def try_wires(bench: Bench, led: int, times: ShotTimes) -> Wires:
    """Flash once with the camera armed on its line, and return which signals arrived.

    Raises
    ------
    RigError
        If the board fails, or if the camera fails for another reason than a missing frame.
    """
    times.check(bench.board.identity)
    time.sleep(max(0.0, bench.ready_s - time.monotonic()))
    frame_id = bench.camera.expect()
    report = bench.board.flash(led, times.ahead_us, times.hold_us)
    bench.triggered(times, time.monotonic())
    try:
        bench.camera.fetch(frame_id, bench.config.frame_timeout_s)
    except FrameTimeoutError:
        return Wires(False, report.active_us is not None)
    return Wires(True, report.active_us is not None)
