"""Calibration boards: the one that options describe, and its page at true size as PDF or PNG."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import acquisition
import calibration
from sgp.cli.exit import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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


PAPERS_MM: Final = {"a4": (297.0, 210.0), "a3": (420.0, 297.0)}
PNG_DPI: Final = 600
BAR_MM: Final = 100.0

_MM_PER_INCH: Final = 25.4
_POINTS_PER_MM: Final = 72 / _MM_PER_INCH
_MARGIN_MM: Final = 9.0
_BELOW_MM: Final = 15.0  # caption and bar below the board
_QUIET_MM: Final = 5.0  # white around the squares


def write_board_page(path: Path, board: calibration.CharucoBoard, paper: str) -> None:
    """Write one landscape page with a board, a caption and two bars of 100 mm.

    Raises
    ------
    UsageError
        If the board does not fit on the paper.
    StorageError
        If the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    page = PAPERS_MM[paper]
    check_fits(board, paper)
    figure = Figure(figsize=(page[0] / _MM_PER_INCH, page[1] / _MM_PER_INCH))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(0, page[0])
    axes.set_ylim(page[1], 0)  # y down, as on the board
    axes.axis("off")
    _draw(axes, board, page)
    file = io.BytesIO()
    if path.suffix.lower() == ".pdf":
        figure.savefig(file, format="pdf", metadata={"CreationDate": None, "Producer": None})
    else:
        figure.savefig(file, format="png", dpi=PNG_DPI, metadata={"Software": None})
    acquisition.write_durably(path, file.getbuffer())


def check_fits(board: calibration.CharucoBoard, paper: str) -> None:
    """Refuse a board that is too large for the paper."""
    width, height = (side - 2 * _MARGIN_MM for side in PAPERS_MM[paper])
    height -= _BELOW_MM + 2 * _QUIET_MM
    largest = min(width / board.columns, height / board.rows)
    if board.square_mm > largest:
        raise UsageError(
            f"{board.columns} x {board.rows} squares of {board.square_mm:g} mm do not fit on "
            f"{paper.upper()}: use squares of at most {int(largest * 10) / 10:g} mm, or fewer"
        )


def caption(board: calibration.CharucoBoard) -> str:
    """Return what is printed below the board."""
    return (
        f"ChArUco {board.columns} x {board.rows} squares of {board.square_mm:g} mm, markers "
        f"{board.marker_mm:g} mm, dictionary {board.dictionary}. Print at 100 %. Both bars must be "
        f"{BAR_MM:g} mm long."
    )


def _draw(axes: Axes, board: calibration.CharucoBoard, page: tuple[float, float]) -> None:
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    left = (page[0] - board.size_mm[0]) / 2
    top = (page[1] - _BELOW_MM - board.size_mm[1]) / 2
    for rectangles, colour in zip(board.black_mm(), ("black", "white"), strict=True):
        shapes = [Rectangle((left + x, top + y), w, h) for x, y, w, h in rectangles]
        axes.add_collection(PatchCollection(shapes, facecolor=colour, edgecolor="none"))
    bottom = page[1] - _MARGIN_MM
    width = 0.3 * _POINTS_PER_MM
    style: dict[str, Any] = {"color": "black", "lw": width, "solid_capstyle": "butt"}
    # A bar across and one along the left edge; their ends are short strokes.
    first = left
    axes.plot([first, first + BAR_MM], [bottom, bottom], **style)
    for x in (first, first + BAR_MM):
        axes.plot([x, x], [bottom - 2, bottom + 2], **style)
    side, end = _MARGIN_MM, top + board.size_mm[1]
    axes.plot([side, side], [end - BAR_MM, end], **style)
    for y in (end - BAR_MM, end):
        axes.plot([side - 2, side + 2], [y, y], **style)
    axes.text(first, bottom - 4, caption(board), fontsize=8, va="bottom", ha="left")
