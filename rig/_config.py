"""What a rig file (rig.toml) says."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from rig._complaint import first_complaint
from rig._errors import RigConfigError, RigNotFoundError


class RigConfig(BaseModel):
    """One rig: which driver opens it, and what the driver and the controller need to know.

    Parameters
    ----------
    name
        What people call the rig; recorded with every session.
    driver
        Entry point of the group ``sgp.rigs`` that opens it.
    leds
        How many LEDs there are, counted from 0.
    settle_ms
        From the board's confirmation that an LED is on to the trigger, 0 to 1000.
    dead_leds
        LEDs known to be broken; shooting with one is refused.
    frame_timeout_s
        How long after the end of an exposure its frame may arrive, up to 60.
    options
        Handed to the driver, which checks them.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: str = Field(min_length=1)
    driver: str = Field(min_length=1)
    leds: Annotated[int, Field(ge=1, le=4096)] = 36
    settle_ms: Annotated[float, Field(ge=0, le=1000)] = 2.0
    dead_leds: tuple[int, ...] = ()
    frame_timeout_s: Annotated[float, Field(gt=0, le=60)] = 2.0
    options: dict[str, Any] = {}

    @model_validator(mode="after")
    def _dead_leds_exist(self) -> Self:
        for led in self.dead_leds:
            if not 0 <= led < self.leds:
                raise ValueError(f"dead LED {led} is not one of 0 to {self.leds - 1}")
        return self


def read_rig_config(path: Path) -> RigConfig:
    """Read a rig file.

    Raises
    ------
    RigNotFoundError
        If there is no such file.
    RigConfigError
        If it cannot be read, is not TOML, or holds a key or value that is not understood.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise RigNotFoundError(f"{path}: no such rig file") from error
    except OSError as error:
        raise RigConfigError(f"{path}: cannot be read ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RigConfigError(f"{path}: not a TOML file ({error})") from error
    try:
        return RigConfig.model_validate(content)
    except ValidationError as error:
        complaint = first_complaint(error, known=RigConfig.model_fields)
        raise RigConfigError(f"{path}: {complaint}") from error
