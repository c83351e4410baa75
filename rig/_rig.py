"""Board and camera as one: every frame knows its LED, and no LED is left burning."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Literal

from rig._board.board import Board
from rig._board.values import BoardEcho
from rig._camera import Camera, Trigger
from rig._config import RigConfig
from rig._errors import RigError, close_after, note
from rig._lights import Lights
from rig._shooting.exposure import Exposure
from rig._shooting.sequence import run, runs
from rig._shooting.shooting import Bench, by_board, by_software, hold_ms
from rig._shooting.shot import Shot
from rig._shooting.wires import Wires, try_wires


class Rig(Lights):
    """An open rig, its lights and its camera, closed as `Lights` are.

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
        self.camera = camera
        self._bench = Bench(board, camera, config)
        self._settings: tuple[float, float] | None = None
        self._exposure: Exposure | None = None
        self._armed: Trigger | None = None
        # Frames that the camera has room for.
        self._frames = 1
        # The light goes first, whatever fails after it.
        closing = board.off, camera.disarm, camera.close, board.close, on_close
        super().__init__(board, config, closing)
        try:
            board.ping()
            self._arm("line" if config.trigger == "board" else "software")
        except BaseException as error:
            close_after(error, self.close)
            raise

    def shoot(
        self,
        led: int | None,
        exposure_us: float,
        gain_db: float = 0.0,
        *,
        trigger: Literal["software", "board"] | None = None,
    ) -> Shot:
        """Take one frame under one LED, or with all LEDs dark.

        Parameters
        ----------
        led
            The LED, or None for a dark or ambient frame.
        exposure_us, gain_db
            Within the camera's range.
        trigger
            Who starts the exposure, where not the rig file's.

        Raises
        ------
        RigError
            If the LED does not exist or is listed as dead, the board or the camera fails, the
            frame is not the one awaited, or the LED did not burn until the exposure ended. The
            LEDs are off then, or the message's note says that the board did not confirm it.

        Notes
        -----
        A board that starts the exposure is told the length of the light with it. Otherwise the
        light ends with the frame's arrival, by the board's watchdog where this program has died,
        and in any case when its hold is over.
        """
        self._check_led(led)
        exposure = self._configure(exposure_us, gain_db)
        by_pulse = (trigger or self.config.trigger) == "board"
        try:
            self._arm("line" if by_pulse else "software")
            return (by_board if by_pulse else by_software)(self._bench, led, exposure)
        except BaseException as error:
            self._off_after(error)
            raise

    def prepare(self, exposure_us: float, gain_db: float = 0.0) -> None:
        """Set the camera as for a shot and take none: tells early whether it can be taken.

        Raises
        ------
        RigError
            If camera or board cannot do it.
        """
        exposure = self._configure(exposure_us, gain_db)
        if self.config.trigger == "board":
            exposure.check(self.board.identity)
        else:
            hold_ms(self._bench, exposure)

    def sequence(
        self, leds: Sequence[int | None], exposure_us: float, gain_db: float = 0.0
    ) -> Iterator[Shot]:
        """Let the board run through LEDs by itself, and yield a shot of each in turn.

        The camera's line must be wired to the board's trigger output. Every shot that is yielded
        is proven: the board says that this LED burned during the whole exposure, and the camera's
        clock tells the same spacing of frames as the board's of triggers.

        Parameters
        ----------
        leds
            In the order in which they are lit; None is a dark frame.
        exposure_us, gain_db
            Within the camera's range, the same for all.

        Yields
        ------
        Shot
            The first one only when the second has come, which proves it.

        Raises
        ------
        RigError
            As `shoot`, naming LED and frame. The LEDs are off then and the run is ended, as they
            are when the iterator is closed early.

        Notes
        -----
        The board does not wait: take the shots as fast as the camera delivers them. Whoever holds
        on to one for more than a second stops the run, since nobody gives the board a sign of life
        meanwhile.
        """
        for led in leds:
            self._check_led(led)
        exposure = self._configure(exposure_us, gain_db)
        try:
            parts = tuple(runs(tuple(leds), self.board.identity.max_steps))
            self._arm("line", max(map(len, parts), default=1))
            self._bench.chain.cut()
            for part in parts:
                # Two frames alone do not prove each other: a lost trigger and a stray one could
                # stand in for them.
                if len(part) <= 2:
                    for led in part:
                        yield by_board(self._bench, led, exposure)
                else:
                    yield from run(self._bench, part, exposure)
        except BaseException as error:
            self._off_after(error)
            raise

    def wires(self, led: int, exposure_us: float) -> Wires:
        """Try by one flash whether board and camera are wired to each other.

        Parameters
        ----------
        led
            Which LED is to flash.
        exposure_us
            Within the camera's range.

        Raises
        ------
        RigError
            If the LED is not there or the board fails; a trigger that does not arrive is no error.
        """
        self._check_led(led)
        exposure = self._configure(exposure_us, 0.0)
        try:
            self._arm("line")
            return try_wires(self._bench, led, exposure)
        except BaseException as error:
            self._off_after(error)
            raise
        finally:
            self._armed = None

    def off(self) -> BoardEcho:
        """Turn all LEDs off.

        Raises
        ------
        BoardError
            If the board does not confirm it.
        """
        return self.board.off()

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

    def _configure(self, exposure_us: float, gain_db: float) -> Exposure:
        if self._exposure is None or self._settings != (exposure_us, gain_db):
            self._exposure = None
            # Cameras that stamp the end of an exposure, or begin it later, shift by its length.
            self._bench.chain.cut()
            real_us = self.camera.configure(exposure_us=exposure_us, gain_db=gain_db)
            # The frame period may hang on the exposure.
            self._exposure = Exposure.of(self.camera.info, self.config, real_us)
            self._settings = (exposure_us, gain_db)
        return self._exposure

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

    def _off_after(self, error: BaseException) -> None:
        """Turn the LEDs off on the way out of an error, which stays the one that is told."""
        # Frames that are still to come must not be taken for those of later shots.
        self._armed = None
        self._bench.chain.cut()
        try:
            self.board.off()
        except RigError as failure:
            note(error, "LEDs not confirmed off", failure)
