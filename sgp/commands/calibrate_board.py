"""``sgp calibrate board``: print a calibration board."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import calibration
from sgp.calibrate import squares_of, write_board_page
from sgp.cli.exit import UsageError
from sgp.cli.options import Positive
from sgp.results import BoardMetrics, Result, check_file


def board(
    *,
    out: Path,
    squares: str = "11x8",
    square_mm: Positive = 15.0,
    marker_mm: Positive | None = None,
    dictionary: str = "4x4_250",
    paper: Literal["a4", "a3"] = "a4",
    force: bool = False,
) -> Result:
    """Write a calibration board to print, at its true size.

    The board is a ChArUco board: a checkerboard with a marker in each white square. Print it at
    100 %, check with a ruler that both bars are 100 mm long, and glue it to a flat plate. The file
    board.json next to it describes the board for `sgp calibrate camera`.

    For example:

        sgp calibrate board --out board.pdf
        sgp calibrate board --squares 14x9 --square-mm 25 --paper a3 --out b.pdf

    Parameters
    ----------
    out
        Page to write: .pdf, or .png with its density (600 dpi). A .json file with the same name is
        written next to it.
    squares
        Squares across and down, such as 11x8.
    square_mm
        Side of a square in mm.
    marker_mm
        Side of a marker in mm; default: 3/4 of a square.
    dictionary
        Markers: bits and number, from 4x4_50 to 7x7_1000.
    paper
        Paper in landscape format.
    force
        Overwrite existing files.
    """
    if out.suffix.lower() not in (".pdf", ".png"):
        raise UsageError(f"{out}: --out must end in .pdf or .png")
    sidecar = out.with_suffix(".json")
    check_file(out, out.suffix.lower(), force=force)
    check_file(sidecar, ".json", force=force)
    columns, rows = squares_of(squares)
    chosen = calibration.CharucoBoard(columns, rows, square_mm, marker_mm, dictionary)
    write_board_page(out, chosen, paper)
    calibration.camera.write_board(sidecar, chosen)
    width, height = chosen.size_mm
    return Result(
        outputs={"page": out, "board": sidecar},
        metrics=BoardMetrics(
            width_mm=width, height_mm=height, corners=len(chosen.corners_mm), markers=chosen.markers
        ),
        summary=[
            f"{out}: {columns} x {rows} squares, {width:g} x {height:g} mm on {paper.upper()}",
            "print it at 100 %, and check with a ruler that both bars are 100 mm long",
        ],
    )
