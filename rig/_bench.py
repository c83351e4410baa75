"""The bench itself: the driver ``bench`` finds board and camera and opens them as a rig."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from rig._board.board import Board
from rig._board.ports import find_board
from rig._camera import Camera
from rig._complaint import complaints
from rig._config import RigConfig
from rig._errors import BoardError, RigConfigError, close_after
from rig._lights import Lights
from rig._rig import Rig


class BenchOptions(BaseModel):
    """The ``options`` of a rig file whose driver is ``bench``.

    Parameters
    ----------
    port
        Serial port of the LED board; ``auto`` asks all ports for it.
    board
        Name of the board's firmware, where several boards are plugged in.
    cti
        The camera maker's GenTL producer, a file ``*.cti``; needed for the camera.
    camera, model
        Serial number or model of the camera, where several are plugged in.
    pixel_format
        For instance ``Mono12``; otherwise the best that the camera has: 12 bit before all others.
    trigger_line
        The camera's input that the board's trigger output is wired to.
    frame_rate_hz
        Limits the camera, where the computer does not keep up.
    black_level
        In the camera's own unit; left as it is otherwise.
    readout_us
        From the first to the last row of a rolling shutter, of cameras that do not tell it.
    buffer_mib
        Memory that frames under way may take, MiB: a sequence gets a buffer for each of its frames
        where they fit. By default 1024, or a quarter of the computer's memory where that is less.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    cti: Annotated[str, Field(min_length=1)] | None = None
    port: Annotated[str, Field(min_length=1)] = "auto"
    board: str | None = None
    camera: str | None = None
    model: str | None = None
    pixel_format: str | None = None
    trigger_line: str = "Line0"
    frame_rate_hz: Annotated[float, Field(gt=0)] | None = None
    black_level: float | None = None
    readout_us: Annotated[float, Field(ge=0)] | None = None
    buffer_mib: Annotated[int, Field(ge=1, le=2**20)] | None = None


def open_bench(config: RigConfig) -> Rig:
    """Open the LED board and the GenICam camera of a rig file: the driver ``bench``.

    Parameters
    ----------
    config
        With the ``options`` that `BenchOptions` lists.

    Raises
    ------
    RigConfigError
        If an option is missing or not understood.
    RigError
        If board or camera are not found, do not open, or do not fit to the rig file.
    """
    options = _options(config)
    if options.cti is None:
        raise RigConfigError(
            f"rig {config.name}: where the camera is found has to be told: write a rig file with "
            'driver = "bench" and, under [options], cti = "..." (see docs/rig-and-plan-files.md)'
        )
    board = _board(config, options)
    with _given_back(board):
        # The light first: an earlier program may have left one on, and cameras are slow to open.
        board.off()
        camera = _camera(options.cti, options)
    return Rig(board, camera, config)


def open_bench_lights(config: RigConfig) -> Lights:
    """Open only the LED board of a rig file of the driver ``bench``.

    Raises
    ------
    RigConfigError
        If an option is not understood.
    RigError
        If the board is not found, does not open, or does not fit to the rig file.
    """
    return Lights(_board(config, _options(config)), config)


def _options(config: RigConfig) -> BenchOptions:
    try:
        return BenchOptions.model_validate(config.options)
    except ValidationError as error:
        complaint = complaints(error, noun="option", known=BenchOptions.model_fields)
        raise RigConfigError(f"rig {config.name}: {complaint}") from error


def _board(config: RigConfig, options: BenchOptions) -> Board:
    port = find_board(name=options.board) if options.port == "auto" else options.port
    board = Board(port)
    with _given_back(board):
        if options.board not in (None, board.identity.name):
            raise BoardError(
                f"LED board on {port} is {board.identity.name}, rig {config.name} wants "
                f"{options.board}: correct port or board in the rig file"
            )
    return board


@contextlib.contextmanager
def _given_back(board: Board) -> Iterator[None]:
    """Close the board where something fails."""
    try:
        yield
    except BaseException as error:
        close_after(error, board.close)
        raise


def _camera(cti: str, options: BenchOptions) -> Camera:
    # harvesters takes a while to import; who only asks for options is spared it.
    from rig._genicam.camera import open_genicam

    return open_genicam(
        Path(cti).expanduser(),
        serial=options.camera,
        model=options.model,
        pixel_format=options.pixel_format,
        trigger_line=options.trigger_line,
        frame_rate_hz=options.frame_rate_hz,
        black_level=options.black_level,
        readout_us=options.readout_us,
        most_bytes=None if options.buffer_mib is None else options.buffer_mib * 2**20,
    )
