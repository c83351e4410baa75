"""Sequences: the board steps through a list of LEDs by itself, and every frame is proven."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from rig._errors import BoardError, CameraError, RigError
from rig.board.values import BoardEcho, StepReport
from rig.host import clock
from rig.messages.notice import pluralize
from rig.shooting.frame_proof import Spacing
from rig.shooting.keep_alive import SignOfLife
from rig.shooting.shooting import Bench, check_id, check_light, explained
from rig.shooting.shot import Shot, led_name
from rig.shooting.shot_times import LONGEST_RUN, ShotTimes

# How much later than declared the board may report a step.
_REPORT_TIMEOUT_S = 1.0
_POLL_S = 0.001
_CHECK = (
    "check the wire from the board's trigger output to the camera's line, and trigger_line and "
    "frame_period_ms in the rig file"
)


def runs(leds: tuple[int | None, ...], most: int) -> Iterator[tuple[int | None, ...]]:
    """Yield the LEDs in the fewest parts of nearly equal length with at most ``most`` LEDs each.

    A part has a single LED only if unavoidable: the spacing of frames proves nothing for one frame.
    """
    parts = -(-len(leds) // max(1, min(most, LONGEST_RUN)))
    ends = [len(leds) * part // max(1, parts) for part in range(parts + 1)]
    for start, end in pairwise(ends):
        yield leds[start:end]


def run(bench: Bench, leds: tuple[int | None, ...], times: ShotTimes) -> Iterator[Shot]:
    """Load one run of three LEDs or more, start it, and yield every shot as soon as it is proven.

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
    begins_s = clock.monotonic()
    alive, spacing = SignOfLife(board.ping), Spacing(camera.info.serial)
    held_back: list[Shot] = []
    for index, (led, step) in enumerate(zip(leds, steps, strict=True)):
        lit_s = begins_s + (step.settle_us + step.hold_us) / 1e6
        begins_s = lit_s + step.gap_us / 1e6
        left_s = max(0.0, lit_s - clock.monotonic()) + bench.config.frame_timeout_s
        try:
            frame = camera.fetch(ids[index], left_s, alive)
        except CameraError as error:
            where = f"it is step {index} of a sequence, with {led_name(led)}{_progress(bench)}"
            raise explained(error, where, _CHECK) from error
        report = _report(bench, index, lit_s)
        bench.triggered(times, clock.monotonic() - times.needed_us / 1e6)
        check_light(bench, led, times, report)
        what = f"the step of {led_name(led)}"
        check_id(camera, frame, ids[index], what, "take the sequence again")
        spacing.check(frame, led, report.trigger_us)
        shot = Shot(frame, led, BoardEcho(started.seq, report.led, report.lit_us, report.active_us))
        held_back.append(shot)
        # The first two frames are proven by their distances from the third.
        if index > 1:
            yield from held_back
            held_back.clear()


def _report(bench: Bench, index: int, lit_s: float) -> StepReport:
    """Wait for the board's report of a step."""
    ends_s = max(lit_s, clock.monotonic()) + _REPORT_TIMEOUT_S
    while (report := bench.board.step_report(index)) is None:
        if clock.monotonic() >= ends_s:
            raise BoardError(
                f"LED board on {bench.board.port} has not done step {index} of its sequence, "
                f"although its frame has arrived{_progress(bench)}; take the sequence again"
            )
        clock.sleep(_POLL_S)
    return report


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
