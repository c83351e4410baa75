"""The LED board of a rig without the camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Self

from rig._errors import BoardError, close_after, closed_after_errors, note
from rig.board.board import Board
from rig.config.rig_file import RigConfig
from rig.host import program
from rig.shooting.lights_off import watch


class OpenBoard:
    """The open LED board of a rig; all LEDs are off after opening and after closing.

    It is closed at the end of its ``with`` block, by `close`, or at interpreter exit. While it is
    open, signals that end the program turn the LEDs off first (`rig.shooting.lights_off`).

    Parameters
    ----------
    board
        Open board.
    config
        Configuration of the rig.
    closing
        Functions that `close` calls, in this order; by default it turns the LEDs off and closes the
        board.

    Raises
    ------
    BoardError
        If the board's LED count differs from the configuration or the board does not answer;
        everything has been closed then.
    """

    def __init__(
        self, board: Board, config: RigConfig, closing: Sequence[Callable[[], object]] = ()
    ) -> None:
        self.board = board
        self.config = config
        self._closing = list(closing) or [board.off, board.close]
        # Board and camera may have been opened again since, as other objects.
        self._unwatch = watch(lambda: self.board.darken())
        with closed_after_errors(self.close):
            if board.identity.leds != config.leds:
                raise BoardError(
                    f"LED board on {board.port} has {board.identity.leds} LEDs, but rig "
                    f"{config.name} is configured with {config.leds}: correct the rig file"
                )
            board.off()
        program.at_exit(self.close)

    def close(self) -> None:
        """Turn the LEDs off and close board and camera; closing twice does nothing.

        Raises
        ------
        RigError
            The first failure, after everything has been closed as far as possible.
        """
        first: Exception | None = None
        # A step is removed when it is done, so that an interrupted close can be resumed.
        while self._closing:
            try:
                self._closing[0]()
            except Exception as error:  # noqa: BLE001
                if first is None:
                    first = error
                else:
                    note(first, "on closing", error)
            del self._closing[0]
        self._unwatch()
        program.not_at_exit(self.close)
        if first is not None:
            raise first

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self.close()
        else:
            close_after(error, self.close)
