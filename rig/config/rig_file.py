"""The content of a rig file (rig.toml)."""

from __future__ import annotations

from math import isqrt
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from rig._errors import RigConfigError, RigNotFoundError
from rig.arrays import Str
from rig.files.guard import MAX_TOML_BYTES, UnreadableError, parse_toml, read_bounded
from rig.messages.notice import pluralize
from rig.messages.validation import validation_message

_Scalar = TypeVar("_Scalar", bound=np.generic)
# A limit of 100 m is larger than any dome.
_Millimetres = Annotated[float, Field(strict=True, ge=-100_000, le=100_000)]


class Mounting(BaseModel):
    """How to make stored frames upright: mirror them left to right first, then turn them clockwise.

    The upright frame has X right and Y up, like the LED positions and the camera model.

    Parameters
    ----------
    rotation_deg
        Angle by which a frame is turned clockwise: 0, 90, 180 or 270.
    mirror
        Whether the frame is mirrored left to right before that, as for a camera behind a mirror.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    rotation_deg: Literal[0, 90, 180, 270] = 0
    mirror: bool = False

    def upright(self, pixels: npt.NDArray[_Scalar]) -> npt.NDArray[_Scalar]:
        """Return a frame ``(H, W)`` or ``(H, W, 3)`` upright."""
        seen = pixels[:, ::-1] if self.mirror else pixels
        return np.ascontiguousarray(np.rot90(seen, -self.rotation_deg // 90))

    def stored(self, pixels: npt.NDArray[_Scalar]) -> npt.NDArray[_Scalar]:
        """Return an upright image as this camera delivers it; the inverse of `upright`."""
        seen = np.rot90(pixels, self.rotation_deg // 90)
        return np.ascontiguousarray(seen[:, ::-1] if self.mirror else seen)

    def upright_shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Return the shape that `upright` or `stored` gives a frame of this shape."""
        height, width, *rest = shape
        return (width, height, *rest) if self.rotation_deg in (90, 270) else shape

    def upright_cfa(self, cfa: str, size: tuple[int, int]) -> str:
        """Return the colour filter pattern of the upright frame.

        Parameters
        ----------
        cfa
            Colours of the square block that repeats, row by row from the top left of the frame.
        size
            (H, W) of the frame as stored; it matters whether a side is a multiple of the block.

        Raises
        ------
        ValueError
            If the block is not square.
        """
        return _pattern(self.upright(_mosaic(cfa, size)), cfa)

    def stored_cfa(self, cfa: str, size: tuple[int, int]) -> str:
        """Return the pattern of the frame as stored, given that of its upright image."""
        return _pattern(self.stored(_mosaic(cfa, size)), cfa)


def _mosaic(cfa: str, size: tuple[int, int]) -> Str:
    """Return the smallest mosaic whose borders cut the pattern as those of the frame do."""
    side = isqrt(len(cfa))
    if side * side != len(cfa):
        raise ValueError(f"the colour filter pattern {cfa} is not a square block")
    block = np.array(list(cfa)).reshape(side, side)
    more: Any = [(0, length % side) for length in size]
    return np.pad(block, more, mode="wrap")


def _pattern(mosaic: Str, cfa: str) -> str:
    side = isqrt(len(cfa))
    return "".join(mosaic[:side, :side].ravel())


class RigConfig(BaseModel):
    """Configuration of one rig: its driver, and the settings of the driver and the controller.

    Parameters
    ----------
    name
        Name of the rig; recorded with every session.
    driver
        Entry point of the group ``sgp.rigs`` that opens it.
    leds
        Number of LEDs, counted from 0.
    settle_ms
        Time from the board's confirmation that an LED is on to the trigger, 0 to 1000.
    dead_leds
        LEDs known to be broken; shooting with one is refused.
    led_positions_mm
        Position of each LED, ``(x, y, z)`` in the frame of the upright image, either for every LED
        or for none. The self-test needs them to detect swapped LEDs.
    led_positions_sigma_mm
        Standard deviation of each coordinate of these positions; that of a tape measure by default.
    trigger
        What starts an exposure: ``software``, a command from this program to the camera; ``board``,
        a pulse from the LED board on a wire.
    exposure_active
        Whether the camera's exposure-active output is wired to the board.
    frame_period_ms
        Least time between two exposures, for a camera that does not report it; 0 if not known.
    frame_timeout_s
        How long after the end of an exposure its frame may arrive, up to 60.
    reconnect_s
        How long a recording waits for a board or camera that no longer answers, up to 3600; 0 ends
        the recording at once.
    mounting
        How the camera is mounted.
    sensor
        File with the measured sensor of the camera, which recordings store; a path in a rig file is
        relative to the folder of this file.
    options
        Options for the driver, which checks them.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: str = Field(min_length=1)
    driver: str = Field(min_length=1)
    leds: Annotated[int, Field(strict=True, ge=1, le=4096)] = 36
    settle_ms: Annotated[float, Field(strict=True, ge=0, le=1000)] = 2.0
    dead_leds: tuple[Annotated[int, Field(strict=True)], ...] = ()
    led_positions_mm: tuple[tuple[_Millimetres, _Millimetres, _Millimetres], ...] = ()
    led_positions_sigma_mm: Annotated[float, Field(strict=True, gt=0, le=1000)] = 10.0
    trigger: Literal["software", "board"] = "software"
    exposure_active: Annotated[bool, Field(strict=True)] = False
    frame_period_ms: Annotated[float, Field(strict=True, ge=0, le=60_000)] = 0.0
    frame_timeout_s: Annotated[float, Field(strict=True, gt=0, le=60)] = 2.0
    reconnect_s: Annotated[float, Field(strict=True, ge=0, le=3600)] = 30.0
    mounting: Mounting = Mounting()
    sensor: Path | None = None
    options: dict[str, Any] = {}

    def __repr__(self) -> str:
        return f"RigConfig({self.name}, driver {self.driver}, {pluralize(self.leds, 'LED')})"

    @model_validator(mode="after")
    def _leds_fit(self) -> Self:
        for led in self.dead_leds:
            if not 0 <= led < self.leds:
                raise ValueError(f"dead LED {led} is not one of 0 to {self.leds - 1}")
        if self.led_positions_mm and len(self.led_positions_mm) != self.leds:
            raise ValueError(
                f"led_positions_mm has {pluralize(len(self.led_positions_mm), 'position')} for "
                f"{pluralize(self.leds, 'LED')}"
            )
        if len(set(self.led_positions_mm)) < len(self.led_positions_mm):
            raise ValueError("led_positions_mm has two LEDs at the same position")
        if self.led_positions_mm and max(z for _, _, z in self.led_positions_mm) <= 0:
            raise ValueError(
                "led_positions_mm has no LED above the working plane: Z points to the camera"
            )
        return self


def read_rig_config(path: Path) -> RigConfig:
    r"""Read a rig file.

    Raises
    ------
    RigNotFoundError
        If there is no such file.
    RigConfigError
        If it cannot be read, is not TOML, or contains an unknown key or an invalid value.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig import read_rig_config
    >>> _ = Path("desk.toml").write_text('name = "desk"\ndriver = "simulated"\nleds = 4\n')
    >>> read_rig_config(Path("desk.toml"))
    RigConfig(desk, driver simulated, 4 LEDs)
    """
    try:
        content = parse_toml(read_bounded(path, MAX_TOML_BYTES))
    except FileNotFoundError as error:
        raise RigNotFoundError(f"{path}: no such rig file") from error
    except UnreadableError as error:
        raise RigConfigError(f"{path}: {error}") from error
    try:
        config = RigConfig.model_validate(content)
    except ValidationError as error:
        message = validation_message(error, known=RigConfig.model_fields)
        raise RigConfigError(f"{path}: {message}") from error
    if config.sensor is None:
        return config
    return config.model_copy(update={"sensor": path.parent / config.sensor.expanduser()})
