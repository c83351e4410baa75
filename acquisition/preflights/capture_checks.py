"""Pre-flight: find problems that would spoil a recording before it starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from acquisition.plan.plan import CapturePlan, frame_bytes
from acquisition.preflights.check import Check
from acquisition.preflights.rig import (
    check_board,
    check_brightness,
    check_camera,
    check_disk,
    check_leds,
)
from acquisition.preflights.trial_frames import (
    Trials,
    check_exposure,
    check_focus,
    check_response,
    check_room,
    check_steadiness,
)
from rig import CameraFrame, Progress, Rig, RigError, no_progress, pluralize
from rig.arrays import UInt16

_STEADY_SHOTS = 5

_Step = tuple[str, Callable[[], Check]]


@dataclass(frozen=True)
class Preflight:
    """Results of all checks, in order."""

    checks: tuple[Check, ...]

    def __repr__(self) -> str:
        failed = ", ".join(check.name for check in self.failed) or "none"
        return f"Preflight({pluralize(len(self.checks), 'check')}, failed: {failed})"

    @property
    def ok(self) -> bool:
        """Whether no check failed; warnings are allowed."""
        return not self.failed

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if check.state == "failed")

    @property
    def doubtful(self) -> tuple[Check, ...]:
        """The checks after which a recording is useless unless their finding is accepted."""
        return tuple(check for check in self.checks if check.doubt)

    def details(self) -> dict[str, Any]:
        """Return the details of the event ``checked`` of a session."""
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
    self_test: bool | Check = True,
    on_progress: Progress = no_progress,
) -> Preflight:
    """Check disk, board, camera, image and every LED for a plan.

    The object must be under the camera, in place for the recording. About twenty frames are taken,
    and with the self-test some more of each LED; none is stored. The brightness of the plan's LEDs
    is set to full scale.

    Parameters
    ----------
    rig
        Open rig. It stays open, with all LEDs off.
    plan
        Plan of the recording, without LEDs that are listed as dead.
    folder
        Folder of the planned session.
    white_level_dn
        Grey value from which a sample is clipped; default the maximum of the camera's bit depth.
    self_test
        Whether to test every LED of the rig; or the result of `check_leds`, if this was done.
    on_progress
        Receives the stage ``checking``, one step per check.

    Returns
    -------
    Preflight
        A rig error becomes a failed check and is not raised; the checks that need the rig are then
        ``not done``.

    Examples
    --------
    >>> from acquisition import CapturePlan
    >>> from acquisition.preflights import preflight
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("coin", width=64, height=52, leds=4))
    >>> plan = CapturePlan(leds="0-3", exposures_us=(20_000.0,))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     result = preflight(rig, plan, "coin", self_test=False)
    >>> [check.name for check in result.checks][:3]
    ['disk', 'board', 'camera']
    """
    trial_frames = _TrialFrames(rig, plan, white_level_dn)
    steps = [
        *_rig_steps(rig, plan),
        ("response", lambda: check_response(trial_frames.trials)),
        ("exposure", trial_frames.exposure),
        ("focus", lambda: check_focus(trial_frames.trials)),
        ("room light", lambda: check_room(trial_frames.trials)),
        ("steadiness", trial_frames.steadiness),
    ]
    if isinstance(self_test, Check):
        steps.append(("LEDs", lambda: self_test))
    elif self_test:
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
    """Check disk, board and camera before a session is resumed.

    Shorter than `preflight`, because the image was checked when the session started. Two frames are
    taken with all LEDs off, and the brightness of the plan's LEDs is set to full scale.

    Parameters
    ----------
    rig, on_progress
        As for `preflight`.
    plan
        Plan of the session, without LEDs that are now listed as dead.
    folder
        The session.
    shots
        Number of shots to take.

    Returns
    -------
    Preflight
        As `preflight`.

    Examples
    --------
    >>> from acquisition import CapturePlan
    >>> from acquisition.preflights import preflight_resume
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("coin", width=64, height=52, leds=4))
    >>> plan = CapturePlan(leds="0-3", exposures_us=(20_000.0,))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     result = preflight_resume(rig, plan, "coin", shots=2)
    >>> [check.name for check in result.checks]
    ['disk', 'board', 'camera', 'brightness']
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
    """Run the steps after the first check; after the rig failed, the others are not done."""
    done: list[Check] = []

    def report(check: Check) -> None:
        done.append(check)
        on_progress("checking", len(done), len(steps) + 1)

    report(first)
    broken = ""
    for name, step in steps:
        if broken:
            check = Check(name, "not done", f"the {broken} check failed")
        else:
            try:
                check = step()
            except RigError as error:
                notes = getattr(error, "__notes__", ())
                check = Check(name, "failed", "; ".join([str(error), *notes]))
                broken = name
            if check.state == "failed" and name in ("board", "camera"):
                broken = name
        report(check)
    return Preflight(tuple(done))


def _bytes(rig: Rig, shots: int) -> int:
    info = rig.camera.info
    return shots * frame_bytes(info.width, info.height)


class _TrialFrames:
    """Trial frames under the middle LED of the plan, taken when first needed."""

    def __init__(self, rig: Rig, plan: CapturePlan, white_level_dn: float | None) -> None:
        info = rig.camera.info
        self._rig = rig
        self._plan = plan
        self._white_dn = float(info.white_dn if white_level_dn is None else white_level_dn)
        self._led = plan.leds[len(plan.leds) // 2]
        self._exposures_us = plan.exposures_of(self._led)

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

    def _pixels(self, led: int | None, exposure_us: float) -> UInt16:
        return self._frame(led, exposure_us).pixels
