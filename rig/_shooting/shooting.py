"""Single shots: light, trigger, frame, and the board's word for what burned."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from rig._board.board import ON_OFF_TIMEOUT_S, Board
from rig._board.values import BoardEcho, FlashReport, StepReport
from rig._camera import Camera, CameraFrame
from rig._config import RigConfig
from rig._errors import BoardError, CameraError, FrameLostError, RigError
from rig._shooting.alive import SignOfLife
from rig._shooting.exposure import CLOCK_JITTER_US, CLOCK_SHARE, Exposure
from rig._shooting.flash_chain import FlashChain
from rig._shooting.shot import Shot, led_name


@dataclass
class Bench:
    """What a shot is taken with.

    Parameters
    ----------
    board
        Open board.
    camera
        Armed camera.
    config
        What is known of the rig.
    ready_s
        When the camera takes its next trigger, on the monotonic clock.

    Attributes
    ----------
    chain
        What the next flash is compared with.
    """

    board: Board
    camera: Camera
    config: RigConfig
    ready_s: float = 0.0

    def __post_init__(self) -> None:
        self.chain = FlashChain(self.camera.info.serial)

    def triggered(self, exposure: Exposure, latest_s: float) -> None:
        """Note that the camera was triggered at this time or before."""
        self.ready_s = latest_s + exposure.period_us / 1e6


def hold_ms(bench: Bench, exposure: Exposure) -> int:
    """Return for how long an ON must declare its light at most; its OFF usually comes much earlier.

    The hold covers settling and exposure, a frame that is as late as it may be, and ON and OFF
    repeated as often as they may be. A host that dies is noticed sooner, by the board's watchdog.

    Raises
    ------
    RigError
        If the board does not give light for settling, exposure and repetitions.
    """
    # The board's clock may be too fast.
    burns_us = exposure.settle_us + exposure.needed_us * (1 + CLOCK_SHARE) + CLOCK_JITTER_US
    needed_ms = burns_us / 1000 + ON_OFF_TIMEOUT_S * 1000
    longest_ms = bench.board.identity.max_hold_ms
    if needed_ms > longest_ms:
        raise RigError(
            f"an exposure of {exposure.needed_us:g} us needs light for {needed_ms:.0f} ms, the "
            f"LED board on {bench.board.port} gives {longest_ms}: expose shorter"
        )
    # A board that cannot wait for the latest frame allowed may still do for those in time.
    return min(math.ceil(needed_ms + bench.config.frame_timeout_s * 1000), longest_ms)


def by_software(bench: Bench, led: int | None, exposure: Exposure) -> Shot:
    """Light an LED, trigger the camera by a command, and turn the LED off when its frame is there.

    Raises
    ------
    RigError
        If board or camera fail, or the LED did not burn until the frame was there.
    """
    board, camera = bench.board, bench.camera
    ends_s, begins_s = math.inf, time.monotonic()
    # The wait for the camera is spent before the light burns, but for its settling.
    SignOfLife(board.ping).sleep_until(bench.ready_s - exposure.settle_us / 1e6)
    if led is None:
        board.off()
    else:
        length_ms = hold_ms(bench, exposure)
        begins_s = time.monotonic()
        ends_s = begins_s + length_ms / 1000
        board.on(led, length_ms)
    alive = SignOfLife(
        lambda: _check_burning(board, led, board.status().led, ends_s, alive), begins_s
    )
    alive.sleep_until(max(bench.ready_s, time.monotonic() + exposure.settle_us / 1e6))
    frame_id = camera.trigger()
    bench.triggered(exposure, time.monotonic())
    timeout_s = exposure.needed_us / 1e6 + bench.config.frame_timeout_s
    frame = _awaited(camera, led, frame_id, camera.fetch(frame_id, timeout_s, alive))
    # The port is ours alone and one ON means one spell of light: an LED that burns now has burned
    # since its ON.
    echo = board.off()
    _check_burning(board, led, echo.led, ends_s, alive)
    return Shot(frame, led, echo)


def by_board(bench: Bench, led: int | None, exposure: Exposure) -> Shot:
    """Let the board light an LED, trigger the camera by a pulse, and turn the LED off by itself.

    The first flash for a while follows a dark one, which gives the frame to compare it with.

    Raises
    ------
    RigError
        If board or camera fail, the LED did not burn during the whole exposure, or the frame is
        not of the board's trigger.
    """
    exposure.check(bench.board.identity)
    if not bench.chain.reaches(exposure):
        shot, _ = _flash(bench, None, exposure, f"no LED, before {led_name(led)}")
        bench.chain.begin(shot.frame)
    shot, report = _flash(bench, led, exposure, led_name(led))
    bench.chain.check(shot.frame, led, report.since_us, exposure)
    return shot


def _flash(
    bench: Bench, led: int | None, exposure: Exposure, light: str
) -> tuple[Shot, FlashReport]:
    board, camera = bench.board, bench.camera
    SignOfLife(board.ping).sleep_until(bench.ready_s - exposure.ahead_us / 1e6)
    frame_id = camera.expect()
    report = board.flash(led, exposure.ahead_us, exposure.hold_us)
    bench.triggered(exposure, time.monotonic() - exposure.needed_us / 1e6)
    check_light(bench, led, exposure, report, light)
    pulsed = f"the LED board on {board.port} did pulse its trigger line under {light}"
    check = "check the wire from there to the camera's line, and trigger_line in the rig file"
    try:
        frame = camera.fetch(frame_id, bench.config.frame_timeout_s)
    except FrameLostError as error:
        raise error.because(pulsed if error.host_is_slow else f"{pulsed}: {check}") from error
    except CameraError as error:
        raise CameraError(f"{error}; {pulsed}: {check}") from error
    echo = BoardEcho(report.seq, report.led, report.lit_us, report.active_us)
    shot = Shot(_awaited(camera, led, frame_id, frame), led, echo)
    return shot, report


def check_light(
    bench: Bench,
    led: int | None,
    exposure: Exposure,
    report: FlashReport | StepReport,
    light: str = "",
) -> None:
    """Refuse a frame whose light the board does not confirm from the trigger to the end.

    Raises
    ------
    BoardError
        If another LED burned, or not for long enough, or the camera exposed beyond it.
    """
    where = f"LED board on {bench.board.port}, flash of {light or led_name(led)}"
    if report.led != led:
        raise BoardError(
            f"{where}: the board lit {led_name(report.led)}; the frame is thrown away, check the "
            "board's firmware"
        )
    if bench.config.exposure_active and report.active_us is None:
        raise BoardError(
            f"{where}: the camera's exposure-active line was not seen; check that wire and the "
            "camera's line output, or set exposure_active = false in the rig file"
        )
    if led is None:
        return
    lit_us = report.lit_us - exposure.ahead_us
    # An exposure that was seen to end before the light did is covered, whatever the clocks say.
    seen = bench.config.exposure_active and bench.camera.info.shutter == "global"
    if report.cut_off or (lit_us < exposure.needed_us and not seen):
        raise BoardError(
            f"{where}: after the trigger the light burned for {max(0, lit_us)} us of the "
            f"{exposure.needed_us:g} us that the exposure takes; the frame is thrown away, shoot "
            "again"
        )


def _check_burning(
    board: Board, led: int | None, burned: int | None, ends_s: float, alive: SignOfLife
) -> None:
    if burned == led:
        return
    where = f"LED board on {board.port}"
    if burned is None and (silence_s := alive.silence_s) >= board.identity.watchdog_ms / 1000:
        raise FrameLostError(
            f"{where}: {led_name(led)} went out before its frame was there, because this computer "
            f"was too busy to speak to the board for up to {silence_s:.1f} s; the frame is thrown "
            "away, end other programs and shoot again"
        )
    if burned is None and time.monotonic() >= ends_s:
        raise BoardError(
            f"{where}: the hold of {led_name(led)} ended while its frame was awaited, so the frame "
            "is thrown away; find out why it came so late, or expose shorter, and shoot again"
        )
    raise BoardError(
        f"{where}: {led_name(led)} was wanted, but during the exposure {led_name(burned)} burned; "
        "the frame is thrown away, check the board's supply and shoot again"
    )


def _awaited(camera: Camera, led: int | None, frame_id: int, frame: CameraFrame) -> CameraFrame:
    if frame.frame_id != frame_id:
        raise FrameLostError(
            f"camera {camera.info.serial} delivered frame {frame.frame_id} for the shot with "
            f"{led_name(led)}, awaited was frame {frame_id}: shoot again"
        )
    return frame
