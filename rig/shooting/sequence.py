"""Sequences: the board steps through a list of LEDs by itself, and every frame is proven."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import pairwise

from rig._errors import BoardError, CameraError, FrameLostError, RigError
from rig.board.values import BoardEcho, StepReport
from rig.camera.interface import CameraFrame
from rig.messages.notice import pluralize
from rig.shooting.frame_proof import Spacing
from rig.shooting.keep_alive import SignOfLife
from rig.shooting.shooting import Bench, check_light
from rig.shooting.shot import Shot, led_name
from rig.shooting.shot_times import LONGEST_RUN, ShotTimes

# How much later than declared the board may report a step.
_REPORT_TIMEOUT_S = 1.0
_POLL_S = 0.001


def runs(leds: tuple[int | None, ...], most: int) -> Iterator[tuple[int | None, ...]]:
    """Yield the LEDs in the fewest parts of nearly equal length with at most ``most`` LEDs each.

    A part has a single LED only if unavoidable: the spacing of frames proves nothing for one frame.
    """
    parts = -(-len(leds) // max(1, min(most, LONGEST_RUN)))
    ends = [len(leds) * part // max(1, parts) for part in range(parts + 1)]
    for start, end in pairwise(ends):
        yield leds[start:end]


def run(bench: Bench, leds: tuple[int | None, ...], times: ShotTimes) -> Iterator[Shot]:
    """Load one run of two LEDs or more, start it, and yield every shot as soon as it is proven.

    Raises
    ------
    RigError
        If a frame does not arrive or is not proven to be that of its LED. The shots yielded before
        are proven.
    """
    board, camera = bench.board, bench.camera
    times.check(board.identity)
    steps = tuple(times.steps(leds))
    board.load(steps)
    SignOfLife(board.ping).sleep_until(bench.ready_s - times.ahead_us / 1e6)
    # In order: no frame may be mistaken for an earlier one.
    ids = [camera.expect() for _ in steps]
    paced = bench.config.exposure_active and camera.info.shutter == "global"
    started = board.run(len(steps), "exposure" if paced else "time")
    begins_s = time.monotonic()
    alive, spacing = SignOfLife(board.ping), Spacing(camera.info.serial)
    held_back: Shot | None = None
    for index, (led, step) in enumerate(zip(leds, steps, strict=True)):
        lit_s = begins_s + (step.settle_us + step.hold_us) / 1e6
        begins_s = lit_s + step.gap_us / 1e6
        left_s = max(0.0, lit_s - time.monotonic()) + bench.config.frame_timeout_s
        try:
            frame = camera.fetch(ids[index], left_s, alive)
        except CameraError as error:
            raise _lost(bench, index, led, error) from error
        report = _report(bench, index, lit_s)
        bench.triggered(times, time.monotonic() - times.needed_us / 1e6)
        check_light(bench, led, times, report)
        _check_id(bench, led, ids[index], frame)
        spacing.check(frame, led, report.trigger_us)
        # The first frame is proven by its distance from the second.
        if held_back is not None:
            yield held_back
            held_back = None
        shot = Shot(frame, led, BoardEcho(started.seq, report.led, report.lit_us, report.active_us))
        if index == 0:
            held_back = shot
        else:
            yield shot


def _report(bench: Bench, index: int, lit_s: float) -> StepReport:
    """Wait for the board's report of a step."""
    ends_s = max(lit_s, time.monotonic()) + _REPORT_TIMEOUT_S
    while (report := bench.board.step_report(index)) is None:
        if time.monotonic() >= ends_s:
            raise BoardError(
                f"LED board on {bench.board.port} has not done step {index} of its sequence, "
                f"although its frame has arrived{_progress(bench)}; take the sequence again"
            )
        time.sleep(_POLL_S)
    return report


def _check_id(bench: Bench, led: int | None, expected: int, frame: CameraFrame) -> None:
    if frame.frame_id != expected:
        raise FrameLostError(
            f"camera {bench.camera.info.serial} delivered frame {frame.frame_id} for the step of "
            f"{led_name(led)} instead of frame {expected}: take the sequence again"
        )


def _lost(bench: Bench, index: int, led: int | None, error: CameraError) -> CameraError:
    where = f"it is step {index} of a sequence, with {led_name(led)}{_progress(bench)}"
    check = (
        "check the wire from the board's trigger output to the camera's line, and trigger_line and "
        "frame_period_ms in the rig file"
    )
    if not isinstance(error, FrameLostError):
        return CameraError(f"{error}; {where}: {check}")
    return error.with_context(where if error.host_is_slow else f"{where}: {check}")


def _progress(bench: Bench) -> str:
    """Return how far the board has come, if it answers."""
    try:
        status = bench.board.status()
    except RigError as error:
        return f", and the board does not answer ({error})"
    stopped = {
        "HALT": "the board stopped by itself, because an exposure or a sign of life was missing,",
        "RUN": "the board continues",
    }.get(status.state, f"the board is {status.state}")
    return f"; {stopped} after {pluralize(status.done, 'step')}"
