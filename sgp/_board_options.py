"""The calibration board that options of a command describe."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import calibration
from sgp._exit import UsageError


def squares_of(text: str) -> tuple[int, int]:
    """Read ``11x8``: squares across and down.

    Raises
    ------
    UsageError
        If the text has another form.
    """
    match = re.fullmatch(r"([1-9]\d{0,2})x([1-9]\d{0,2})", text.strip())
    if match is None:
        raise UsageError(
            f"--squares {text[:40]}: give the squares across and down, for example 11x8"
        )
    return int(match[1]), int(match[2])


def board_of(
    path: Path | None,
    squares: str | None,
    square_mm: float | None,
    marker_mm: float | None,
    dictionary: str | None,
) -> calibration.CharucoBoard:
    """Return the board of a file, or the one that is described; a size given with a file is used.

    Raises
    ------
    UsageError
        If the board is not described completely, or twice.
    MissingPathError, DataError
        As `calibration.read_board`.
    """
    if path is None:
        if squares is None or square_mm is None:
            raise UsageError("give --board board.json, or the board's --squares and --square-mm")
        columns, rows = squares_of(squares)
        return calibration.CharucoBoard(
            columns, rows, square_mm, marker_mm, dictionary or "4x4_250"
        )
    if squares is not None or dictionary is not None or marker_mm is not None:
        raise UsageError(
            "--board describes the board: only --square-mm may be given as well, as measured"
        )
    board = calibration.read_board(path)
    if square_mm is None:
        return board
    marker_mm = (board.marker_mm or 0) * square_mm / board.square_mm
    return replace(board, square_mm=square_mm, marker_mm=marker_mm)
