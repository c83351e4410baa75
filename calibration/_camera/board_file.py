"""Files of calibration boards: board.json."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from acquisition import missing_path, write_durably
from calibration._camera.board import CharucoBoard
from calibration._errors import DataError
from rig import UnreadableError, check_text, read_bounded, validation_message

_VERSION: Final = 1
_Positive = Annotated[float, Field(gt=0)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _BoardFile(_Table):
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
    >>> from calibration import CharucoBoard, read_board, write_board
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
    >>> from calibration import CharucoBoard, write_board
    >>> write_board("board.json", CharucoBoard(5, 4, 20))
    >>> Path("board.json").read_text()[:40]
    '{"format": "sgp-board", "version": 1, "c'
    """
    path = Path(path)
    if path.suffix.lower() != ".json":
        raise DataError(f"{path}: calibration boards are written as .json: give such a name")
    content = {"format": "sgp-board", "version": _VERSION, **asdict(board)}
    write_durably(path, (json.dumps(content) + "\n").encode())
