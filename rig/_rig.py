"""Board and camera as one: every frame knows its LED, and no LED is left burning."""

from __future__ import annotations

import atexit
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from rig._board import ON_OFF_TIMEOUT_S, Board, BoardEcho
from rig._camera import Camera, CameraFrame
from rig._config import RigConfig
from rig._errors import BoardError, CameraError, RigError


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame and the light it was taken under.

    Parameters
    ----------
    frame
        What the camera saw.
    led
        The LED that burned during the whole exposure, None where all were dark.
    echo
        The board's word for it: its answer to the OFF that ended the shot.
    """

    frame: CameraFrame
    led: int | None
    echo: BoardEcho | None


class Rig:
    """An open rig, which it closes: on leaving its ``with``, on `close`, or at interpreter exit.

    Parameters
    ----------
    board
        Open board; must have the LED count that ``config`` states.
    camera
        Open camera.
    config
        What is known about the rig.
    on_close
        Called after board and camera are closed.

    Raises
    ------
    RigError
        If board, camera and configuration do not fit; all that was handed over is closed then.
    """

    def __init__(
        self,
        board: Board,
        camera: Camera,
        config: RigConfig,
        *,
        on_close: Callable[[], None] = lambda: None,
    ) -> None:
        self.board = board
        self.camera = camera
        self.config = config
        self._settings: tuple[float, float] | None = None
        self._exposure_us = 0.0
        # The light goes first, whatever fails after it.
        self._closing: list[Callable[[], object]] = [
            board.off,
            camera.disarm,
            camera.close,
            board.close,
            on_close,
        ]
        try:
            if board.identity.leds != config.leds:
                raise BoardError(
                    f"LED board on {board.port} has {board.identity.leds} LEDs, rig "
                    f"{config.name} is said to have {config.leds}: correct the rig file"
                )
            board.off()
            camera.arm()
        except BaseException as error:
            self._close_after(error)
            raise
        atexit.register(self.close)

    def shoot(self, led: int | None, exposure_us: float, gain_db: float = 0.0) -> Shot:
        """Take one frame under one LED, or with all LEDs dark.

        Parameters
        ----------
        led
            The LED, or None for a dark or ambient frame.
        exposure_us, gain_db
            Within the camera's range.

        Raises
        ------
        RigError
            If the LED does not exist or is listed as dead, the board or the camera fails, the
            frame is not the one awaited, or the LED did not burn until the exposure ended. The
            LEDs are off then, or the message's note says that the board did not confirm it.

        Notes
        -----
        The board holds the LED for settling and exposure, for a frame that is as late as it may
        be, and for ON and OFF repeated as often as they may be. A host that dies leaves the LED
        burning for no longer than that.
        """
        self._check_led(led)
        self._configure(exposure_us, gain_db)
        hold_ends_s = math.inf
        try:
            if led is None:
                self.board.off()
            else:
                hold_ms = self._hold_ms()
                hold_ends_s = time.monotonic() + hold_ms / 1000
                self.board.on(led, hold_ms)
            time.sleep(self.config.settle_ms / 1000)
            frame = self._expose(led)
            echo = self.board.off()
        except BaseException as error:
            self._off_after(error)
            raise
        # The port is ours alone and one ON means one spell of light: an LED that burns now has
        # burned since its ON.
        if echo.led is None and time.monotonic() >= hold_ends_s:
            raise BoardError(
                f"LED board on {self.board.port}: the hold of {_name(led)} ended while its frame "
                "was awaited, so the frame is thrown away; find out why it came so late, or expose "
                "shorter, and shoot again"
            )
        if echo.led != led:
            raise BoardError(
                f"LED board on {self.board.port}: {_name(led)} was wanted, but at the end of the "
                f"exposure {_name(echo.led)} burned; the frame is thrown away, check the board's "
                "supply and shoot again"
            )
        return Shot(frame, led, echo)

    def off(self) -> BoardEcho:
        """Turn all LEDs off.

        Raises
        ------
        BoardError
            If the board does not confirm it.
        """
        return self.board.off()

    def close(self) -> None:
        """Turn the LEDs off and give board and camera back; closing twice does nothing.

        Raises
        ------
        RigError
            The first failure, after everything has been closed as far as possible.
        """
        first: RigError | None = None
        # A step leaves the list when it is done, so that a close cut short can be taken up again.
        while self._closing:
            try:
                self._closing[0]()
            except RigError as error:
                if first is None:
                    first = error
                else:
                    _note(first, "on closing", error)
            del self._closing[0]
        atexit.unregister(self.close)
        if first is not None:
            raise first

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            self._close_after(error)

    def _check_led(self, led: int | None) -> None:
        if led is None:
            return
        if not 0 <= led < self.config.leds:
            raise RigError(
                f"rig {self.config.name} has no LED {led}, only 0 to {self.config.leds - 1}"
            )
        if led in self.config.dead_leds:
            raise RigError(
                f"LED {led} of rig {self.config.name} is listed as dead: leave it out, or mend it "
                "and strike it from dead_leds in the rig file"
            )

    def _configure(self, exposure_us: float, gain_db: float) -> None:
        if self._settings != (exposure_us, gain_db):
            self._settings = None
            self._exposure_us = self.camera.configure(exposure_us=exposure_us, gain_db=gain_db)
            self._settings = (exposure_us, gain_db)

    def _hold_ms(self) -> int:
        needed_ms = self.config.settle_ms + self._exposure_us / 1000 + ON_OFF_TIMEOUT_S * 1000
        longest_ms = self.board.identity.max_hold_ms
        if needed_ms > longest_ms:
            raise RigError(
                f"an exposure of {self._exposure_us:g} us needs light for {needed_ms:.0f} ms, the "
                f"LED board on {self.board.port} gives {longest_ms}: expose shorter"
            )
        # A board that cannot wait for the latest frame allowed may still do for those in time.
        return min(math.ceil(needed_ms + self.config.frame_timeout_s * 1000), longest_ms)

    def _expose(self, led: int | None) -> CameraFrame:
        frame_id = self.camera.trigger()
        timeout_s = self._exposure_us / 1e6 + self.config.frame_timeout_s
        frame = self.camera.fetch(frame_id, timeout_s)
        if frame.frame_id != frame_id:
            raise CameraError(
                f"camera {self.camera.info.serial} delivered frame {frame.frame_id} for the shot "
                f"with {_name(led)}, awaited was frame {frame_id}: shoot again"
            )
        return frame

    def _off_after(self, error: BaseException) -> None:
        """Turn the LEDs off on the way out of an error, which stays the one that is told."""
        try:
            self.board.off()
        except RigError as failure:
            _note(error, "LEDs not confirmed off", failure)

    def _close_after(self, error: BaseException) -> None:
        try:
            self.close()
        except RigError as failure:
            _note(error, "on closing", failure)


def _note(error: BaseException, what: str, failure: RigError) -> None:
    """Tell of a failure, and of what it notes itself, beside the error that came first."""
    for said in (str(failure), *getattr(failure, "__notes__", ())):
        error.add_note(f"{what}: {said}")


def _name(led: int | None) -> str:
    return "no LED" if led is None else f"LED {led}"
