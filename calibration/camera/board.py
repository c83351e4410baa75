"""ChArUco boards: a checkerboard with a marker in every white square."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from acquisition import missing_path, write_durably
from calibration._errors import DataError
from rig import Notice, UnreadableError, pluralize, read_bounded, short_repr
from rig.arrays import Bool, Float64, Int64
from rig.files import check_text
from rig.messages import validation_message

_BITS: Final = ("4x4", "5x5", "6x6", "7x7")
_COUNTS: Final = (50, 100, 250, 1000)
# OpenCV's predefined dictionaries of markers, by our names.
DICTIONARIES: Final = tuple(f"{bits}_{count}" for bits in _BITS for count in _COUNTS)
_MARKER_SHARE: Final = 0.75
_FEWEST, _MOST = 3, 60
_MOST_MM: Final = 5000.0
_Positive = Annotated[float, Field(gt=0)]
_SAME_PX: Final = 1.0


@dataclass(frozen=True)
class CharucoBoard:
    """A flat checkerboard with markers, for calibrating a camera.

    Parameters
    ----------
    columns, rows
        Squares across and down, 3 to 60 each.
    square_mm
        Side of a square, as measured on the print.
    marker_mm
        Side of a marker, smaller than a square; default: 3/4 of it.
    dictionary
        Markers: bits and number, from ``4x4_50`` to ``7x7_1000``.

    Raises
    ------
    DataError
        If a value is out of range, or the dictionary has fewer markers than the board.

    Examples
    --------
    >>> from calibration import CharucoBoard
    >>> board = CharucoBoard(11, 8, 15)
    >>> board.size_mm, len(board.corners_mm), board.markers
    ((165.0, 120.0), 70, 44)
    """

    columns: int = 11
    rows: int = 8
    square_mm: float = 15.0
    marker_mm: float | None = None
    dictionary: str = "4x4_250"

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.marker_mm is None:
            object.__setattr__(self, "marker_mm", _MARKER_SHARE * self.square_mm)
        if not all(_FEWEST <= n <= _MOST for n in (self.columns, self.rows)):
            raise DataError(
                f"a calibration board of {self.columns} x {self.rows} squares: columns and rows "
                f"must be {_FEWEST} to {_MOST}"
            )
        lengths = (float(self.marker_mm or 0), self.square_mm, _MOST_MM)
        if not (all(map(math.isfinite, lengths)) and 0 < lengths[0] < lengths[1] <= lengths[2]):
            raise DataError(
                f"a calibration board with squares of {self.square_mm:g} mm and markers of "
                f"{lengths[0]:g} mm: a marker must be smaller than a square, and a square at most "
                f"{_MOST_MM:g} mm"
            )
        if self.dictionary not in DICTIONARIES:
            raise DataError(
                f"the dictionary {self.dictionary!r} is unknown: use one of "
                + ", ".join(DICTIONARIES)
            )
        available = int(self.dictionary.split("_")[1])
        if self.markers > available:
            raise DataError(
                f"a calibration board of {self.columns} x {self.rows} squares needs "
                f"{self.markers} markers, but {self.dictionary} has {available}: use a larger "
                "dictionary"
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the squares together."""
        return self.columns * self.square_mm, self.rows * self.square_mm

    @property
    def markers(self) -> int:
        """Number of markers; they are numbered from 0, row by row from the upper left."""
        return self.columns * self.rows // 2

    @property
    def corners_mm(self) -> Float64:
        """``(n, 2)`` inner corners, x right and y down from the upper left of the first square."""
        x, y = (np.arange(1.0, count) * self.square_mm for count in (self.columns, self.rows))
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    def black_mm(self) -> tuple[Float64, Float64]:
        """Return what to print: black rectangles, and white ones on them.

        Returns
        -------
        black, white
            ``(n, 4)`` x, y, width and height each, from the upper left of the first square. White
            rectangles of a marker overlap, so that no gap shows between them.
        """
        codes = dictionary_named(self.dictionary).bytesList
        bits, side = int(self.dictionary[0]), float(self.marker_mm or 0)
        module, margin = side / (bits + 2), (self.square_mm - side) / 2
        black, white, marker = [], [], 0
        for row in range(self.rows):
            for column in range(self.columns):
                x, y = column * self.square_mm, row * self.square_mm
                if (row + column) % 2 == 0:
                    black.append((x, y, self.square_mm, self.square_mm))
                    continue
                black.append((x + margin, y + margin, side, side))
                code = codes[marker : marker + 1]
                cells = np.asarray(cv2.aruco.Dictionary.getBitsFromByteList(code, bits)) > 0
                first = np.array([x + margin + module, y + margin + module])
                for i, j, wide, high in _runs(cells):
                    corner = first + module * np.array([j, i])
                    white.append((*corner, wide * module, high * module))
                marker += 1
        return np.array(black, np.float64), np.array(white, np.float64)

    def in_opencv(self) -> Any:
        """Return the same board as `cv2.aruco.CharucoBoard`."""
        return cv2.aruco.CharucoBoard(
            (self.columns, self.rows),
            self.square_mm,
            float(self.marker_mm or 0),
            dictionary_named(self.dictionary),
        )


def dictionary_named(name: str) -> Any:
    """Return one of `DICTIONARIES` as OpenCV's value."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name.upper()}"))


def _runs(cells: Bool) -> list[tuple[int, int, int, int]]:
    """Return all horizontal and vertical runs of True: row, column, width, height."""
    found = []
    for transposed in (False, True):
        for i, line in enumerate(cells.T if transposed else cells):
            edges = np.flatnonzero(np.diff(np.pad(line.astype(np.int8), 1)))
            for begin, end in edges.reshape(-1, 2).tolist():
                run = (begin, i, 1, end - begin) if transposed else (i, begin, end - begin, 1)
                found.append(run)
    return found


@dataclass(frozen=True, eq=False)
class BoardView:
    """Corners of a calibration board in one image.

    Parameters
    ----------
    name
        Name of the image, for messages.
    board
        The board that was found.
    size
        (height, width) of the image.
    ids
        ``(n,)`` indices into `CharucoBoard.corners_mm`.
    corners_px
        ``(n, 2)`` positions (x, y) in the image; the centre of the first pixel is at (0, 0).
    """

    name: str
    board: CharucoBoard
    size: tuple[int, int]
    ids: Int64
    corners_px: Float64

    def __repr__(self) -> str:
        return f"BoardView({self.name}, {pluralize(len(self.ids), 'corner')})"

    @property
    def points_mm(self) -> Float64:
        """``(n, 3)`` the same corners on the board, with z = 0."""
        return np.pad(self.board.corners_mm[self.ids], ((0, 0), (0, 1)))


class _BoardFile(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    format: Literal["sgp-board"]
    version: Literal[1]
    columns: int
    rows: int
    square_mm: _Positive
    marker_mm: _Positive
    dictionary: str


def read_board(path: str | Path) -> CharucoBoard:
    """Read a calibration board from board.json.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If it is not a board.json of this version, or a value is out of range.

    Examples
    --------
    >>> from calibration import CharucoBoard, read_board
    >>> from calibration.camera import write_board
    >>> write_board("board.json", CharucoBoard(11, 8, 15))
    >>> read_board("board.json").square_mm
    15.0
    """
    path = Path(path)
    try:
        text = read_bounded(path).decode("utf-8-sig")
        check_text(text)
        file = _BoardFile.model_validate_json(text)
        return CharucoBoard(**file.model_dump(exclude={"format", "version"}))
    except FileNotFoundError as error:
        raise missing_path(path, "file") from error
    except ValidationError as error:
        raise DataError(f"{path}: not a board.json: {validation_message(error)}") from error
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: not a board.json: it is not text") from error
    except (UnreadableError, DataError) as error:
        raise DataError(f"{path}: {error}") from error


def write_board(path: str | Path, board: CharucoBoard) -> None:
    """Write a calibration board as board.json.

    Raises
    ------
    DataError
        If the file has another suffix.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from calibration import CharucoBoard
    >>> from calibration.camera import write_board
    >>> write_board("board.json", CharucoBoard(5, 4, 20))
    >>> Path("board.json").read_text()[:40]
    '{"format": "sgp-board", "version": 1, "c'
    """
    path = Path(path)
    if path.suffix.lower() != ".json":
        raise DataError(f"{path}: calibration boards are written as .json: give such a name")
    content = {"format": "sgp-board", "version": 1, **asdict(board)}
    write_durably(path, (json.dumps(content) + "\n").encode())


def merge_same_places(views: Sequence[BoardView]) -> tuple[list[BoardView], list[Notice]]:
    """Average views whose corners are within a pixel of each other; return them with a notice."""
    groups: list[list[BoardView]] = []
    for view in views:
        group = next((group for group in groups if _same(group[0], view)), None)
        if group is None:
            groups.append([view])
        else:
            group.append(view)
    notices = []
    for group in groups:
        if len(group) > 1:
            text = (
                f"shows the calibration board at the same place as "
                f"{pluralize(len(group) - 1, 'other image')}: they count as one view"
            )
            notices.append(Notice("views-alike", text, group[0].name, "info"))
    return [_mean(group) for group in groups], notices


def _same(one: BoardView, other: BoardView) -> bool:
    ids, first, second = np.intersect1d(one.ids, other.ids, return_indices=True)
    if 2 * len(ids) < min(len(one.ids), len(other.ids)):
        return False
    apart = np.linalg.norm(one.corners_px[first] - other.corners_px[second], axis=1)
    return bool(np.median(apart) < _SAME_PX)


def _mean(group: Sequence[BoardView]) -> BoardView:
    if len(group) == 1:
        return group[0]
    ids = np.unique(np.concatenate([view.ids for view in group]))
    total, count = np.zeros((len(ids), 2)), np.zeros((len(ids), 1))
    for view in group:
        at = np.searchsorted(ids, view.ids)
        total[at] += view.corners_px
        count[at] += 1
    return replace(group[0], ids=ids, corners_px=total / count)
