"""The driver ``bench``: finds the LED board and the camera and opens them as a rig."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from rig._errors import BoardError, RigConfigError, closed_after_errors
from rig.board.board import Board
from rig.board.ports import find_board
from rig.camera.interface import Camera
from rig.config.rig_file import RigConfig
from rig.messages.validation import validation_message
from rig.rigs.board_only import OpenBoard
from rig.rigs.rig import Rig


class BenchOptions(BaseModel):
    """The ``options`` of a rig file whose driver is ``bench``.

    Parameters
    ----------
    port
        Serial port of the LED board; ``auto`` queries all ports.
    board
        Name of the board's firmware, if several boards are plugged in.
    cti
        The camera vendor's GenTL producer, a file ``*.cti``; needed for the camera.
    camera, model
        Serial number or model of the camera, if several are plugged in.
    pixel_format
        For instance ``Mono12``; by default the best that the camera has: 12 bit before all others.
    trigger_line
        The camera input that is wired to the board's trigger output.
    frame_rate_hz
        Limit of the frame rate, for a computer that is too slow.
    black_level
        Black level in the camera's own unit; unchanged by default.
    readout_us
        Time from the first to the last row of a rolling shutter, for cameras that do not report it.
    buffer_mib
        Memory for pending frames, MiB: a sequence gets one buffer per frame if they fit. By default
        1024, or a quarter of the computer's memory if that is less.
    isolate
        Whether the GenTL producer runs in a separate process, which is ended and started again if
        the producer hangs or crashes.
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
    isolate: bool = False


def open_bench(config: RigConfig) -> Rig:
    """Open the LED board and the GenICam camera of a rig file of the driver ``bench``.

    Parameters
    ----------
    config
        Configuration with the ``options`` that `BenchOptions` lists.

    Raises
    ------
    RigConfigError
        If an option is missing or invalid.
    RigError
        If board or camera are not found, do not open, or do not match the rig file.
    """
    options = _options(config)
    if options.cti is None:
        raise RigConfigError(
            f"rig {config.name}: the camera's GenTL producer is missing: write a rig file with "
            'driver = "bench" and, under [options], cti = "..." (see docs/rig-and-plan-files.md)'
        )
    board = _board(config, options)
    with closed_after_errors(board.close):
        # Before the camera: an earlier program may have left an LED on, and cameras open slowly.
        board.off()
        camera = _camera(options.cti, options)
    # A camera is chosen by model, or as the only one, just once.
    same = options.model_copy(update={"camera": camera.info.serial or options.camera})
    return Rig(board, camera, config, open_camera=partial(_camera, options.cti, same))


def open_bench_board(config: RigConfig) -> OpenBoard:
    """Open only the LED board of a rig file of the driver ``bench``.

    Raises
    ------
    RigConfigError
        If an option is invalid.
    RigError
        If the board is not found, does not open, or does not match the rig file.
    """
    return OpenBoard(_board(config, _options(config)), config)


def _options(config: RigConfig) -> BenchOptions:
    try:
        return BenchOptions.model_validate(config.options)
    except ValidationError as error:
        message = validation_message(error, noun="option", known=BenchOptions.model_fields)
        raise RigConfigError(f"rig {config.name}: {message}") from error


def _board(config: RigConfig, options: BenchOptions) -> Board:
    port = find_board(name=options.board) if options.port == "auto" else options.port
    board = Board(port)
    with closed_after_errors(board.close):
        if options.board not in (None, board.identity.name):
            raise BoardError(
                f"LED board on {port} is {board.identity.name}, but rig {config.name} requires "
                f"{options.board}: correct port or board in the rig file"
            )
    return board


def _camera(cti: str, options: BenchOptions) -> Camera:
    # Imported here because harvesters takes a while to import.
    open_camera: Callable[..., Camera]
    if options.isolate:
        from rig.genicam.isolated import open_isolated as open_camera
    else:
        from rig.genicam.camera import open_genicam as open_camera

    own = {"model", "pixel_format", "trigger_line", "frame_rate_hz", "black_level", "readout_us"}
    return open_camera(
        Path(cti).expanduser(),
        serial=options.camera,
        most_bytes=None if options.buffer_mib is None else options.buffer_mib * 2**20,
        **options.model_dump(include=own),
    )
