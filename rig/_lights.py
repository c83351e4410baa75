"""The LED board of a rig by itself: lights without a camera."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rig._board.board import Board
from rig._config import RigConfig
from rig._errors import BoardError, RigError
from rig._shooting.dark import watch


class Lights:
    """The open LED board of a rig, dark at first; closed, and dark again, on leaving its ``with``.

    While it is open, signals that end the program turn the LEDs off first (`rig._shooting.dark`).

    Parameters
    ----------
    board
        Open board.
    config
        What is known about the rig.

    Raises
    ------
    BoardError
        If the board has not the LED count of the configuration, which closes it, or does not
        answer.
    """

    def __init__(self, board: Board, config: RigConfig) -> None:
        self.board = board
        self.config = config
        self._unwatch = watch(board.darken)
        try:
            check_count(board, config)
            board.off()
        except BaseException as error:
            self._close_after(error)
            raise

    def close(self) -> None:
        """Turn the LEDs off and give the board back.

        Raises
        ------
        BoardError
            If the board does not confirm that it is dark, or closing fails.
        """
        try:
            self.board.off()
        finally:
            self._unwatch()
            self.board.close()

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

    def _close_after(self, error: BaseException) -> None:
        try:
            self.close()
        except RigError as failure:
            error.add_note(f"on closing: {failure}")


def check_count(board: Board, config: RigConfig) -> None:
    """Refuse a board of another LED count than the configuration's.

    Raises
    ------
    BoardError
        If it is one.
    """
    if board.identity.leds != config.leds:
        raise BoardError(
            f"LED board on {board.port} has {board.identity.leds} LEDs, rig {config.name} is said "
            f"to have {config.leds}: correct the rig file"
        )
