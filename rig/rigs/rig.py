"""LED board and camera as one rig: the LED of every frame is known, and no LED stays on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Literal

from rig._errors import (
    CameraError,
    DeviceGoneError,
    RigError,
    closed_after_errors,
    note,
    note_unconfirmed,
)
from rig.board.board import Board
from rig.board.ports import BoardPlace
from rig.board.values import BoardEcho
from rig.camera.interface import Camera, Trigger
from rig.config.rig_file import RigConfig
from rig.host import clock
from rig.messages.representation import differences
from rig.messages.type_check import check_led
from rig.rigs.board_only import OpenBoard
from rig.rigs.reopening import Opening, camera_facts, wait
from rig.shooting.sequence import run, runs
from rig.shooting.shooting import Bench, Wires, by_board, by_software, hold_ms, try_wires
from rig.shooting.shot import Shot
from rig.shooting.shot_times import ShotTimes

# Time between attempts to open a device that is gone.
_AGAIN_AFTER_S = 0.5


class Rig(OpenBoard):
    """An open rig: its LED board and its camera, closed in the same way as `OpenBoard`.

    Parameters
    ----------
    board
        Open board; must have the LED count that ``config`` states.
    camera
        Open camera.
    config
        Configuration of the rig.
    on_close
        Called after board and camera are closed.
    open_camera
        Opens the same camera again after it was gone; None if that is not possible.

    Raises
    ------
    RigError
        If board, camera and configuration do not match; board and camera are closed then.
    """

    def __init__(
        self,
        board: Board,
        camera: Camera,
        config: RigConfig,
        *,
        on_close: Callable[[], None] = lambda: None,
        open_camera: Callable[[], Camera] | None = None,
    ) -> None:
        self.camera = camera
        self._open_camera = open_camera
        self._place = BoardPlace(board)
        self._bench = Bench(board, camera, config)
        self._settings: tuple[float, float] | None = None
        self._times: ShotTimes | None = None
        self._armed: Trigger | None = None
        # Frames that the camera has room for.
        self._frames = 1
        # The LEDs are turned off first, even if a later step fails.
        # Both may have been opened again by then.
        closing = (
            lambda: self.board.off(),
            self._disarm,
            lambda: self.camera.close(),
            lambda: self.board.close(),
            on_close,
        )
        super().__init__(board, config, closing)
        with closed_after_errors(self.close):
            board.ping()
            self._arm_as_stated()

    def shoot(
        self,
        led: int | None,
        exposure_us: float,
        gain_db: float = 0.0,
        *,
        trigger: Literal["software", "board"] | None = None,
    ) -> Shot:
        """Take one frame under one LED, or with all LEDs off.

        Parameters
        ----------
        led
            The LED, or None for a dark or ambient frame.
        exposure_us, gain_db
            Exposure time and gain, within the camera's range.
        trigger
            What starts the exposure; by default as the rig file states.

        Raises
        ------
        RigError
            If the LED does not exist or is listed as dead, the board or the camera fails, the
            frame is not the expected one, or the LED was not on until the exposure ended. The
            LEDs are off then, or a note of the error states that the board did not confirm it.

        Notes
        -----
        If the board starts the exposure, its command includes the length of the light. Otherwise
        the LED is turned off when the frame arrives, by the board's watchdog if this program has
        died, and in any case at the end of its hold.
        """
        self._check_led(led)
        times = self._configure(exposure_us, gain_db)
        by_pulse = (trigger or self.config.trigger) == "board"
        with self._off_after_errors():
            self._arm("line" if by_pulse else "software")
            return (by_board if by_pulse else by_software)(self._bench, led, times)

    def prepare(self, exposure_us: float, gain_db: float = 0.0) -> None:
        """Set the camera as for a shot without taking it, to check early whether it is possible.

        Raises
        ------
        RigError
            If camera or board cannot take the shot.
        """
        times = self._configure(exposure_us, gain_db)
        if self.config.trigger == "board":
            times.check(self.board.identity)
        else:
            hold_ms(self._bench, times)

    def sequence(
        self, leds: Sequence[int | None], exposure_us: float, gain_db: float = 0.0
    ) -> Iterator[Shot]:
        """Let the board step through LEDs by itself, and yield a shot of each in turn.

        The camera's line must be wired to the board's trigger output. Every yielded shot is proven:
        the board reports that this LED was on during the complete exposure, and the frames have the
        same spacing on the camera's clock as the triggers on the board's clock.

        Parameters
        ----------
        leds
            LEDs in the order in which they are turned on; None for a dark frame.
        exposure_us, gain_db
            Exposure time and gain, within the camera's range, the same for all.

        Yields
        ------
        Shot
            The shots in order; the first two only after the third has arrived, which proves them.

        Raises
        ------
        RigError
            As `shoot`; the message names LED and frame. The LEDs are then off and the run has
            ended, as when the iterator is closed early.

        Notes
        -----
        The board does not wait: take the shots as fast as the camera delivers them. A caller that
        delays the next shot by more than a second stops the run, since the board receives no sign
        of life meanwhile.
        """
        for led in leds:
            self._check_led(led)
        times = self._configure(exposure_us, gain_db)
        with self._off_after_errors():
            parts = tuple(runs(tuple(leds), self.board.identity.max_steps))
            self._arm("line", max(map(len, parts), default=1))
            self._bench.chain.cut()
            for part in parts:
                # Two frames do not prove each other: a lost trigger and a stray one could produce
                # the same spacing.
                if len(part) <= 2:
                    for led in part:
                        yield by_board(self._bench, led, times)
                else:
                    yield from run(self._bench, part, times)

    def wires(self, led: int, exposure_us: float) -> Wires:
        """Test with one flash whether board and camera are wired to each other.

        Parameters
        ----------
        led
            LED to flash.
        exposure_us
            Exposure time, within the camera's range.

        Raises
        ------
        RigError
            If the LED does not exist or the board fails; a trigger that does not arrive is not an
            error.
        """
        self._check_led(led)
        times = self._configure(exposure_us, 0.0)
        with self._off_after_errors():
            self._arm("line")
            wires = try_wires(self._bench, led, times)
        self._armed = None
        return wires

    def recover(self, lost: DeviceGoneError, waiting: Callable[[], None] = lambda: None) -> None:
        """Open a device again that is gone: the same board, or the camera with the same serial.

        The next shot may be taken then, unless the other device is gone as well. If it was the
        board, it has confirmed that all LEDs are off.

        Parameters
        ----------
        lost
            Error of the device.
        waiting
            Called at least every 200 ms meanwhile; an exception from it ends the wait.

        Raises
        ------
        DeviceGoneError
            ``lost``, if ``reconnect_s`` of the rig file has passed: the device is not back, or it
            is not the same, with the same settings. A note says what the last attempt found.
        """
        ends_s = clock.monotonic() + self.config.reconnect_s
        self._armed = None
        failure = RigError("it cannot be opened again")
        while clock.monotonic() < ends_s:
            opened = self._opened(lost.device, ends_s, waiting)
            try:
                self._take_over(opened)
            except RigError as error:
                failure = error
            else:
                return
            wait(min(ends_s, clock.monotonic() + _AGAIN_AFTER_S), waiting)
        note(lost, "on opening it again", failure)
        raise lost

    def off(self) -> BoardEcho:
        """Turn all LEDs off.

        Raises
        ------
        BoardError
            If the board does not confirm it.
        """
        return self.board.off()

    def _check_led(self, led: int | None) -> None:
        check_led(led)
        if led is None:
            return
        if not 0 <= led < self.config.leds:
            raise RigError(
                f"rig {self.config.name} has no LED {led}, only 0 to {self.config.leds - 1}"
            )
        if led in self.config.dead_leds:
            raise RigError(
                f"LED {led} of rig {self.config.name} is listed as dead: leave it out, or repair "
                "it and remove it from dead_leds in the rig file"
            )

    def _configure(self, exposure_us: float, gain_db: float) -> ShotTimes:
        if self._times is None or self._settings != (exposure_us, gain_db):
            self._times = None
            # With the exposure time, timestamps shift in cameras that stamp the end of an exposure
            # or delay its start.
            self._bench.chain.cut()
            real_us = self.camera.configure(exposure_us=exposure_us, gain_db=gain_db)
            # The frame period may depend on the exposure time.
            self._times = ShotTimes.of(self.camera.info, self.config, real_us)
            self._settings = (exposure_us, gain_db)
        return self._times

    def _opened(
        self, device: str, ends_s: float, waiting: Callable[[], None]
    ) -> Board | Camera | RigError:
        """Close a device that is gone and open it again; return it, or why it does not open."""
        if device == "board":
            with suppress(RigError):
                self.board.close()
            return Opening(self._place.open).outcome(ends_s, waiting)
        before, open_camera = self.camera, self._open_camera
        if open_camera is None:
            return RigError("this rig cannot open its camera again")

        def again() -> Camera:
            # It may take long to close, too.
            with suppress(RigError):
                before.close()
            return open_camera()

        return Opening(again).outcome(ends_s, waiting)

    def _take_over(self, opened: Board | Camera | RigError) -> None:
        """Use a device that was opened again from now on, if it is the same."""
        if isinstance(opened, RigError):
            raise opened
        if isinstance(opened, Board):
            self.board = self._bench.board = opened
            opened.off()
            return
        if changes := differences(camera_facts(self.camera.info), camera_facts(opened.info)):
            with suppress(RigError):
                opened.close()
            raise CameraError(f"camera {opened.info.serial} is not as before: {changes}")
        self.camera = self._bench.camera = opened
        self._settings = self._times = None
        self._arm_as_stated()
        # A restart of the board meanwhile is no reason to refuse a shot.
        with suppress(RigError):
            self.board.status()

    def _disarm(self) -> None:
        if self._armed is not None:
            self.camera.disarm()

    def _arm_as_stated(self) -> None:
        self._arm("line" if self.config.trigger == "board" else "software")

    def _arm(self, trigger: Trigger, frames: int = 1) -> None:
        if self._armed == trigger and frames <= self._frames:
            return
        self._armed = None
        self._bench.chain.cut()
        if frames > 1:
            self.camera.arm(trigger, frames)
        else:
            self.camera.arm(trigger)
        self._armed, self._frames = trigger, frames

    @contextmanager
    def _off_after_errors(self) -> Iterator[None]:
        """Turn the LEDs off if the block raises an error; a failure is added to it as a note."""
        try:
            yield
        except BaseException as error:
            # Frames that still arrive must not be mistaken for those of later shots.
            self._armed = None
            self._bench.chain.cut()
            try:
                self.board.off()
            except RigError as failure:
                note_unconfirmed(error, failure)
            raise
