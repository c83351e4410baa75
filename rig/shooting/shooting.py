"""Single shots: light, trigger, frame, and the report of the LED; and a test of the wires."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rig._errors import (
    BoardError,
    CameraError,
    CameraGoneError,
    FrameLostError,
    FrameTimeoutError,
    RigError,
)
from rig.board.board import ON_OFF_TIMEOUT_S, Board
from rig.board.values import BoardEcho, FlashReport, StepReport
from rig.camera.interface import Camera, CameraFrame
from rig.config.rig_file import RigConfig
from rig.host import clock
from rig.shooting.frame_proof import FlashChain
from rig.shooting.keep_alive import SignOfLife
from rig.shooting.shot import Shot, led_name
from rig.shooting.shot_times import CLOCK_JITTER_US, CLOCK_SHARE, ShotTimes


@dataclass
class Bench:
    """Board, camera and state for taking shots.

    Parameters
    ----------
    board
        Open board.
    camera
        Armed camera.
    config
        Configuration of the rig.
    ready_s
        When the camera accepts its next trigger, on the monotonic clock.

    Attributes
    ----------
    chain
        Comparison of each flash with the previous one.
    """

    board: Board
    camera: Camera
    config: RigConfig
    ready_s: float = 0.0

    def __post_init__(self) -> None:
        self.chain = FlashChain(self.camera.info.serial)

    def triggered(self, times: ShotTimes, latest_s: float) -> None:
        """Record that the camera was triggered at ``latest_s`` or earlier."""
        self.ready_s = latest_s + times.period_us / 1e6


def hold_ms(bench: Bench, times: ShotTimes) -> int:
    """Return the hold that an ON must declare; its OFF is usually sent much earlier.

    The hold covers settling and exposure, the latest allowed frame, and the largest number of
    repetitions of ON and OFF. If the host dies, the board's watchdog acts sooner.

    Raises
    ------
    RigError
        If the board cannot keep an LED on for settling, exposure and repetitions.
    """
    # The board's clock may be too fast.
    lit_us = times.settle_us + times.needed_us * (1 + CLOCK_SHARE) + CLOCK_JITTER_US
    needed_ms = lit_us / 1000 + ON_OFF_TIMEOUT_S * 1000
    longest_ms = bench.board.identity.max_hold_ms
    if needed_ms > longest_ms:
        raise RigError(
            f"an exposure of {times.needed_us:g} us needs light for {needed_ms:.0f} ms, but the "
            f"LED board on {bench.board.port} allows {longest_ms} ms: expose shorter"
        )
    # A board that cannot wait for the latest allowed frame may still suffice for punctual frames.
    return min(math.ceil(needed_ms + bench.config.frame_timeout_s * 1000), longest_ms)


def by_software(bench: Bench, led: int | None, times: ShotTimes) -> Shot:
    """Turn an LED on, trigger the camera by software, and turn the LED off after the frame arrived.

    Raises
    ------
    RigError
        If board or camera fail, or the LED was not on until the frame arrived.
    """
    board, camera = bench.board, bench.camera
    ends_s, begins_s = math.inf, clock.monotonic()
    # Wait for the camera before turning the LED on, except for the settling time.
    SignOfLife(board.ping).sleep_until(bench.ready_s - times.settle_us / 1e6)
    if led is None:
        board.off()
    else:
        length_ms = hold_ms(bench, times)
        begins_s = clock.monotonic()
        ends_s = begins_s + length_ms / 1000
        board.on(led, length_ms)
    alive = SignOfLife(lambda: _check_lit(board, led, board.status().led, ends_s, alive), begins_s)
    alive.sleep_until(max(bench.ready_s, clock.monotonic() + times.settle_us / 1e6))
    frame_id = camera.trigger()
    bench.triggered(times, clock.monotonic())
    timeout_s = times.needed_us / 1e6 + bench.config.frame_timeout_s
    frame = camera.fetch(frame_id, timeout_s, alive)
    check_id(camera, frame, frame_id, f"the shot with {led_name(led)}", "shoot again")
    # No other program uses the port, and an ON is carried out once: an LED that is on now has been
    # on since its ON.
    echo = board.off()
    _check_lit(board, led, echo.led, ends_s, alive)
    return Shot(frame, led, echo)


def by_board(bench: Bench, led: int | None, times: ShotTimes) -> Shot:
    """Let the board turn an LED on, trigger the camera by a pulse, and turn the LED off by itself.

    After a pause, a dark flash is made first, which gives the first frame to compare with.

    Raises
    ------
    RigError
        If board or camera fail, the LED was not on during the complete exposure, or the frame is
        not that of the board's trigger.
    """
    times.check(bench.board.identity)
    if not bench.chain.reaches(times):
        shot, _ = _flash(bench, None, times, f"no LED, before {led_name(led)}")
        bench.chain.begin(shot.frame)
    shot, report = _flash(bench, led, times, led_name(led))
    bench.chain.check(shot.frame, led, report.since_us, times)
    return shot


def _flash(bench: Bench, led: int | None, times: ShotTimes, light: str) -> tuple[Shot, FlashReport]:
    board, camera = bench.board, bench.camera
    SignOfLife(board.ping).sleep_until(bench.ready_s - times.ahead_us / 1e6)
    frame_id = camera.expect()
    report = board.flash(led, times.ahead_us, times.hold_us)
    bench.triggered(times, clock.monotonic() - times.needed_us / 1e6)
    check_light(bench, led, times, report, light)
    pulsed = f"the LED board on {board.port} pulsed its trigger line for {light}"
    check = "check the wire from the board to the camera's line, and trigger_line in the rig file"
    try:
        frame = camera.fetch(frame_id, bench.config.frame_timeout_s)
    except CameraError as error:
        raise explained(error, pulsed, check) from error
    check_id(camera, frame, frame_id, f"the shot with {led_name(led)}", "shoot again")
    echo = BoardEcho(report.seq, report.led, report.lit_us, report.active_us)
    return Shot(frame, led, echo), report


def explained(error: CameraError, where: str, check: str) -> CameraError:
    """Return the error of an awaited frame with its circumstances, and what to check.

    Nothing needs a check if this computer was too busy.
    """
    if isinstance(error, CameraGoneError):
        return error
    if not isinstance(error, FrameLostError):
        return CameraError(f"{error}; {where}: {check}")
    return error.with_context(where if error.host_is_slow else f"{where}: {check}")


def check_light(
    bench: Bench,
    led: int | None,
    times: ShotTimes,
    report: FlashReport | StepReport,
    light: str = "",
) -> None:
    """Refuse a frame if the board does not confirm its light from the trigger to the end.

    Raises
    ------
    BoardError
        If another LED was on, the LED was not on for long enough, or the camera exposed for longer.
    """
    where = f"LED board on {bench.board.port}, flash of {light or led_name(led)}"
    if report.led != led:
        raise BoardError(
            f"{where}: the board turned on {led_name(report.led)} instead; the frame is discarded, "
            "check the board's firmware"
        )
    if bench.config.exposure_active and report.active_us is None:
        raise BoardError(
            f"{where}: the camera's exposure-active line was not seen; check that wire and the "
            "camera's line output, or set exposure_active = false in the rig file"
        )
    if led is None:
        return
    lit_us = report.lit_us - times.ahead_us
    # An exposure that was seen to end before the light is covered, independently of the clocks.
    seen = bench.config.exposure_active and bench.camera.info.shutter == "global"
    if report.cut_off or (lit_us < times.needed_us and not seen):
        raise BoardError(
            f"{where}: after the trigger the LED was on for {max(0, lit_us)} us of the "
            f"{times.needed_us:g} us that the exposure takes; the frame is discarded, shoot "
            "again"
        )


def _check_lit(
    board: Board, led: int | None, lit: int | None, ends_s: float, alive: SignOfLife
) -> None:
    if lit == led:
        return
    where = f"LED board on {board.port}"
    if lit is None and (silence_s := alive.silence_s) >= board.identity.watchdog_ms / 1000:
        raise FrameLostError(
            f"{where}: {led_name(led)} was turned off before its frame arrived, because this "
            f"computer was too busy to send the board a sign of life for up to {silence_s:.1f} s; "
            "the frame is discarded, end other programs and shoot again"
        )
    if lit is None and clock.monotonic() >= ends_s:
        raise BoardError(
            f"{where}: the hold of {led_name(led)} ended while its frame was awaited, so the frame "
            "is discarded; find out why it was so late, or expose shorter, and shoot again"
        )
    raise BoardError(
        f"{where}: {led_name(led)} was requested, but {led_name(lit)} was on during the exposure; "
        "the frame is discarded, check the board's supply and shoot again"
    )


def check_id(camera: Camera, frame: CameraFrame, expected: int, what: str, remedy: str) -> None:
    """Raise FrameLostError if the camera delivered another frame than the expected one."""
    if frame.frame_id != expected:
        raise FrameLostError(
            f"camera {camera.info.serial} delivered frame {frame.frame_id} for {what} instead of "
            f"frame {expected}: {remedy}"
        )


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
    clock.sleep(max(0.0, bench.ready_s - clock.monotonic()))
    frame_id = bench.camera.expect()
    report = bench.board.flash(led, times.ahead_us, times.hold_us)
    bench.triggered(times, clock.monotonic())
    try:
        bench.camera.fetch(frame_id, bench.config.frame_timeout_s)
    except FrameTimeoutError:
        return Wires(False, report.active_us is not None)
    return Wires(True, report.active_us is not None)
