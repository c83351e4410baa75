"""Pre-flight: what would spoil a recording is found before it begins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from acquisition._plan.estimate import frame_bytes
from acquisition._plan.plan import CapturePlan
from acquisition._preflight.check import Check
from acquisition._preflight.disk import check_disk
from acquisition._preflight.images import (
    Pixels,
    Trials,
    check_exposure,
    check_focus,
    check_response,
    check_room,
    check_steadiness,
)
from acquisition._preflight.rig import check_board, check_brightness, check_camera, check_leds
from rig import CameraFrame, Progress, Rig, RigError, no_progress

_STEADY_SHOTS = 5

_Step = tuple[str, Callable[[], Check]]


@dataclass(frozen=True)
class Preflight:
    """What was checked, in order."""

    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing speaks against recording; warnings do not."""
        return not self.failed

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if check.state == "failed")

    def details(self) -> dict[str, Any]:
        """Return what the event ``checked`` of a session says."""
        return {
            "checks": [
                {"name": check.name, "state": check.state, "text": check.text, **check.values}
                for check in self.checks
            ]
        }


def preflight(
    rig: Rig,
    plan: CapturePlan,
    folder: str | Path,
    *,
    white_level_dn: float | None = None,
    self_test: bool = True,
    on_progress: Progress = no_progress,
) -> Preflight:
    """Check disk, board, camera, picture and every LED against a plan.

    The object lies under the camera as it is to be recorded. Some twenty frames are taken, and
    with the self-test some more of each LED; nothing is kept. The brightness of the plan's LEDs is
    set to full scale.

    Parameters
    ----------
    rig
        Open rig. It stays open, and dark.
    plan
        What is to be recorded, without LEDs that are listed as dead.
    folder
        Of the session to come.
    white_level_dn
        Grey value from which a sample is clipped; default the greatest of the camera's bits.
    self_test
        Whether every LED of the rig is tried.
    on_progress
        Receives the stage ``checking``, one step per check.

    Returns
    -------
    Preflight
        A rig that fails is a failed check, not an error; what needs it is then ``not done``.
    """
    picture = _Picture(rig, plan, white_level_dn)
    steps = [
        *_rig_steps(rig, plan),
        ("response", lambda: check_response(picture.trials)),
        ("exposure", picture.exposure),
        ("focus", lambda: check_focus(picture.trials)),
        ("room light", lambda: check_room(picture.trials)),
        ("steadiness", picture.steadiness),
    ]
    if self_test:
        steps.append(("LEDs", lambda: check_leds(rig, plan)))
    return _carried_out(
        steps, check_disk(Path(folder), _bytes(rig, len(plan.shots()))), on_progress
    )


def preflight_resume(
    rig: Rig,
    plan: CapturePlan,
    folder: str | Path,
    shots: int,
    *,
    on_progress: Progress = no_progress,
) -> Preflight:
    """Check disk, board and camera before a session is gone on with.

    Shorter than `preflight`: the picture was checked when it began. Two frames are taken, in the
    dark, and the brightness of the plan's LEDs is set to full scale.

    Parameters
    ----------
    rig, on_progress
        As for `preflight`.
    plan
        Of the session, without LEDs that are listed as dead by now.
    folder
        The session.
    shots
        How many are to be taken.

    Returns
    -------
    Preflight
        As `preflight`.
    """
    on_disk = check_disk(Path(folder), _bytes(rig, shots))
    return _carried_out(_rig_steps(rig, plan), on_disk, on_progress)


def _rig_steps(rig: Rig, plan: CapturePlan) -> list[_Step]:
    return [
        ("board", lambda: check_board(rig, plan)),
        ("camera", lambda: check_camera(rig, plan)),
        ("brightness", lambda: check_brightness(rig, plan)),
    ]


def _carried_out(steps: Sequence[_Step], first: Check, on_progress: Progress) -> Preflight:
    """Take the steps after the first check; what needs a rig that failed is not done."""
    done: list[Check] = []

    def tell(check: Check) -> None:
        done.append(check)
        on_progress("checking", len(done), len(steps) + 1)

    tell(first)
    broken = ""
    for name, step in steps:
        if broken:
            check = Check(name, "not done", f"the check of the {broken} failed")
        else:
            try:
                check = step()
            except RigError as error:
                notes = getattr(error, "__notes__", ())
                check = Check(name, "failed", "; ".join([str(error), *notes]))
                broken = name
            if check.state == "failed" and name in ("board", "camera"):
                broken = name
        tell(check)
    return Preflight(tuple(done))


def _bytes(rig: Rig, shots: int) -> int:
    info = rig.camera.info
    return shots * frame_bytes(info.width, info.height)


class _Picture:
    """Trial frames under the middle LED of the plan, taken when first asked for."""

    def __init__(self, rig: Rig, plan: CapturePlan, white_level_dn: float | None) -> None:
        info = rig.camera.info
        self._rig = rig
        self._plan = plan
        self._white_dn = float(2**info.bit_depth - 1 if white_level_dn is None else white_level_dn)
        self._led = plan.leds[len(plan.leds) // 2]
        brackets = range(len(plan.exposures_us))
        self._exposures_us = [plan.exposure_us(self._led, bracket) for bracket in brackets]

    @cached_property
    def trials(self) -> Trials:
        low_us = self._rig.camera.info.exposure_min_us
        long_us = max(self._exposures_us)
        half_us = max(long_us / 2, low_us)
        black = self._pixels(None, low_us)
        unlit, half_unlit = self._pixels(None, long_us), self._pixels(None, half_us)
        half = self._frame(self._led, half_us)
        lit, again = self._frame(self._led, long_us), self._frame(self._led, long_us)
        return Trials(
            self._led,
            float(black.mean()),
            self._white_dn,
            (lit.pixels, again.pixels),
            unlit,
            half.pixels,
            half_unlit,
            lit.exposure_us,
            half.exposure_us,
        )

    def exposure(self) -> Check:
        trials = self.trials
        long_us = max(self._exposures_us)
        frames = [(long_us, trials.lit[0])] + [
            (us, self._pixels(self._led, us)) for us in self._exposures_us if us != long_us
        ]
        limit = self._plan.max_clipped_fraction
        return check_exposure(frames, trials.black, self._white_dn, limit)

    def steadiness(self) -> Check:
        short_us = min(self._exposures_us)
        unlit = self._pixels(None, short_us)
        frames = [self._pixels(self._led, short_us) for _ in range(_STEADY_SHOTS)]
        return check_steadiness(self._led, frames, unlit, short_us)

    def _frame(self, led: int | None, exposure_us: float) -> CameraFrame:
        return self._rig.shoot(led, exposure_us, self._plan.gain_db).frame

    def _pixels(self, led: int | None, exposure_us: float) -> Pixels:
        return self._frame(led, exposure_us).pixels
