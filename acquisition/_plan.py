"""What to capture: a frozen plan that unrolls into single shots."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from acquisition._errors import DataError
from acquisition._lights import led_id
from acquisition._toml import read_toml

Role = Literal["light", "dark", "ambient", "flat"]
ShotKey = tuple[Role, int | None, int, int]

_Led = Annotated[int, Field(strict=True, ge=0)]
_Exposure = Annotated[float, Field(gt=0, allow_inf_nan=False)]


@dataclass(frozen=True)
class PlannedShot:
    """One frame to take.

    Parameters
    ----------
    role
        ``light`` (one LED burns), ``dark``, ``ambient`` (both with all LEDs off) or ``flat``.
    led
        LED number from 0 for a light, None otherwise.
    bracket
        Index of the exposure from 0; for dark and ambient frames the first bracket they serve.
    repeat
        0 for the first shot of this LED and bracket, then 1, 2 ...
    exposure_us
        Exposure time asked for, microseconds; None where it is not known (imported images).
    """

    role: Role
    led: int | None
    bracket: int
    repeat: int
    exposure_us: float | None

    @property
    def key(self) -> ShotKey:
        """What identifies the shot: a retake has the key of the shot it replaces."""
        return self.role, self.led, self.bracket, self.repeat

    @property
    def file(self) -> str:
        """File name inside ``frames/`` of the first take."""
        return self.take_file(self.repeat)

    def take_file(self, number: int) -> str:
        """File name with the running number that tells repeats and retakes apart (0: none)."""
        return f"{self._stem()}{f'_R{number}' if number else ''}.tif"

    def _stem(self) -> str:
        if self.led is not None:
            return f"{led_id(self.led)}_E{self.bracket}"
        if self.role == "flat":
            return f"F_E{self.bracket}"
        if self.exposure_us is None:
            raise DataError(f"a {self.role} frame needs its exposure: it is filed by it")
        exposure = float(self.exposure_us)
        text = str(int(exposure)) if exposure.is_integer() else repr(exposure)
        return f"{'D' if self.role == 'dark' else 'A'}_{text}us"


class CapturePlan(BaseModel):
    """What to capture. Frozen; written into the session it leads to.

    Parameters
    ----------
    leds
        LEDs in the order in which they are lit, counted from 0, each once.
    exposures_us
        One exposure time per bracket, microseconds, all different.
    repeats
        Shots of each LED and bracket, 1 to 1000.
    dark
        Take one dark frame for each exposure, before the lights. The LEDs are off; that no other
        light falls on the sensor is up to the operator.
    ambient
        Take one frame with the LEDs off for each exposure, to measure the light in the room.
    gain_db
        Analogue gain, the same for all shots.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    leds: Annotated[tuple[_Led, ...], Field(min_length=1)]
    exposures_us: Annotated[tuple[_Exposure, ...], Field(min_length=1)]
    repeats: Annotated[int, Field(strict=True, ge=1, le=1000)] = 1
    dark: bool = True
    ambient: bool = False
    gain_db: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0

    @field_validator("leds", "exposures_us")
    @classmethod
    def _each_once(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        for value in values:
            if values.count(value) > 1:
                raise ValueError(f"{value:g} is there twice: each may be planned once")
        return values

    def check(self, led_count: int, dead_leds: Iterable[int] = ()) -> None:
        """Check the plan against the board that is to carry it out.

        Parameters
        ----------
        led_count
            LEDs of the board.
        dead_leds
            LEDs known not to work.

        Raises
        ------
        DataError
            If the plan asks for an LED that the board lacks or that is dead.
        """
        for led in self.leds:
            if led >= led_count:
                raise DataError(
                    f"plan: LED {led} does not exist, the board has 0 to {led_count - 1}; "
                    "correct leds in the plan"
                )
        dead = sorted(set(self.leds) & set(dead_leds))
        if dead:
            raise DataError(
                f"plan: LED {dead[0]} is marked dead in the rig file; leave it out of leds"
            )

    def shots(self) -> tuple[PlannedShot, ...]:
        """Return the shots in the order in which they are taken: dark, ambient, lights.

        The exposure changes only from one bracket to the next, as cameras take time for it.
        """
        roles: tuple[tuple[Role, bool], ...] = (("dark", self.dark), ("ambient", self.ambient))
        unlit = [
            PlannedShot(role, None, bracket, 0, exposure_us)
            for role, wanted in roles
            if wanted
            for bracket, exposure_us in enumerate(self.exposures_us)
        ]
        lit = [
            PlannedShot("light", led, bracket, repeat, exposure_us)
            for bracket, exposure_us in enumerate(self.exposures_us)
            for repeat in range(self.repeats)
            for led in self.leds
        ]
        return (*unlit, *lit)


def read_plan(path: Path) -> CapturePlan:
    """Read a plan from a TOML file whose keys are the fields of `CapturePlan`.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If it is not TOML, or a key is unknown or missing, or a value is out of range.
    """
    return read_toml(CapturePlan, path)
