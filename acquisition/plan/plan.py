"""Capture plan: frozen settings that expand into single shots, and what these cost."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Final, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from acquisition._errors import DataError
from acquisition.files.text_files import read_toml, validated
from acquisition.plan.planned_shot import PlannedShot, Role
from rig import pluralize

MOST_LEDS: Final = 65_536

_NUMBER: Final = r"\s*([0-9]{1,5})\s*"
_PART: Final = re.compile(f"{_NUMBER}(?:-{_NUMBER})?")


def led_numbers(text: str) -> tuple[int, ...]:
    """Return the LED numbers of a list with ranges, in its order; ``5-3`` counts down.

    Parameters
    ----------
    text
        Numbers and ranges ``first-last``, separated by commas. A number may appear twice.

    Raises
    ------
    ValueError
        If the text has another form, lists more than 65,536 LEDs, or one above 65,535.

    Examples
    --------
    >>> from acquisition.plan import led_numbers
    >>> led_numbers("0-2,7,5-3")
    (0, 1, 2, 7, 5, 4, 3)
    """
    leds: list[int] = []
    for part in text.split(","):
        match = _PART.fullmatch(part)
        if match is None:
            shown = part.strip()
            raise ValueError(
                f"{shown[:40]!r} is neither an LED number nor a range: write for example "
                '"0-35" or "0-5, 8"'
            )
        first, last = int(match[1]), int(match[2] or match[1])
        if max(first, last) >= MOST_LEDS:
            raise ValueError(f"there is no LED {max(first, last)}: the largest is {MOST_LEDS - 1}")
        step = 1 if first <= last else -1
        leds += range(first, last + step, step)
        if len(leds) > MOST_LEDS:
            raise ValueError(f"more than {MOST_LEDS} LEDs are listed: correct the ranges")
    return tuple(leds)


def _led_number(key: object) -> object:
    """Return the LED number of a TOML key, which is always text."""
    if not isinstance(key, str):
        return key
    if not re.fullmatch(r"0|[1-9][0-9]{0,5}", key):
        raise ValueError(f"{key!r} is not an LED: write its number, for instance 7 for LED 7")
    return int(key)


def _listed(value: object) -> object:
    """Return the LED numbers of a text with ranges; other values stay as they are."""
    return led_numbers(value) if isinstance(value, str) else value


# Far more than a session of 36 LEDs has; expanding a plan of this size is still quick.
_MOST_SHOTS: Final = 1_000_000

_Led = Annotated[int, Field(strict=True, ge=0, lt=MOST_LEDS)]
_LedKey = Annotated[_Led, BeforeValidator(_led_number)]
_Exposure = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
_Exposures = Annotated[tuple[_Exposure, ...], Field(min_length=1)]
_Flag = Annotated[bool, Field(strict=True)]


class CapturePlan(BaseModel):
    """Settings of a recording. Frozen; stored in the session.

    Parameters
    ----------
    leds
        LED numbers from 0, in the order of the shots, each once. A text as `led_numbers` reads it
        is also accepted, for instance ``"0-35"``.
    exposures_us
        One exposure time per bracket, microseconds, all different.
    exposures_by_led
        Exposure times of single LEDs, one per bracket, which replace ``exposures_us``; the keys of
        a TOML file are LED numbers as text.
    repeats
        Shots of each LED and bracket, 1 to 1000.
    dark
        Take one dark frame for each exposure time, before the lights. The LEDs are off; the
        operator must keep all other light off the sensor.
    ambient
        Take one frame with the LEDs off for each exposure time, to measure the light of the room.
    flats
        Number of frames of a white card for each bracket, at the end, 0 to 1000. Each is lit by one
        LED; the LEDs are spread evenly over ``leds``. With as many flats as LEDs, each LED lights
        one.
    repeat
        Take the first light again after all others and before the flats. It shows whether the
        camera or the object moved or the light faded meanwhile, and is not used otherwise. A
        session that is resumed begins with a repeat of its last light.
    repeat_every
        Take the first light again after every so many lights, too; 0 for only at the end.
    gain_db
        Analogue gain, the same for all shots.
    sequence
        Let the board step through the LEDs by itself if the rig supports it.
    retakes
        Number of times that a failed shot may be taken again, 0 to 100.
    max_clipped_fraction
        Largest share of saturated samples that a frame may have.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    leds: Annotated[tuple[_Led, ...], Field(min_length=1), BeforeValidator(_listed)]
    exposures_us: _Exposures
    exposures_by_led: dict[_LedKey, _Exposures] = {}
    repeats: Annotated[int, Field(strict=True, ge=1, le=1000)] = 1
    dark: _Flag = True
    ambient: _Flag = False
    flats: Annotated[int, Field(strict=True, ge=0, le=1000)] = 0
    repeat: _Flag = True
    repeat_every: Annotated[int, Field(strict=True, ge=0, le=_MOST_SHOTS)] = 0
    gain_db: Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)] = 0.0
    sequence: _Flag = False
    retakes: Annotated[int, Field(strict=True, ge=0, le=100)] = 0
    max_clipped_fraction: Annotated[float, Field(strict=True, ge=0, le=1)] = 1.0

    def __repr__(self) -> str:
        counts = {
            "LED": len(self.leds),
            "bracket": len(self.exposures_us),
            "shot": len(self.shots()),
        }
        shown = (pluralize(count, noun) for noun, count in counts.items())
        return f"CapturePlan({', '.join(shown)})"

    @field_validator("leds", "exposures_us")
    @classmethod
    def _each_once(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        for value, count in Counter(values).items():
            if count > 1:
                raise ValueError(f"{value:g} appears twice: list each value once")
        return values

    @model_validator(mode="after")
    def _exposures_fit(self) -> Self:
        leds = set(self.leds)
        shots = len(self.leds) * len(self.exposures_us) * self.repeats
        if shots > _MOST_SHOTS:
            raise ValueError(
                f"leds, exposures_us and repeats make {shots} shots: the limit is {_MOST_SHOTS}"
            )
        if self.repeat_every and not self.repeat:
            raise ValueError("repeat_every needs repeat = true")
        for led, exposures_us in self.exposures_by_led.items():
            if led not in leds:
                raise ValueError(f"exposures_by_led: LED {led} is not one of leds")
            if len(exposures_us) != len(self.exposures_us):
                raise ValueError(
                    f"exposures_by_led: LED {led} has {pluralize(len(exposures_us), 'exposure')}, "
                    f"exposures_us has {len(self.exposures_us)}: give one for each bracket"
                )
            if len(set(exposures_us)) < len(exposures_us):
                raise ValueError(f"exposures_by_led: LED {led} has an exposure twice")
        return self

    @model_serializer(mode="wrap")
    def _written(self, values_of: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Write LED numbers as text, as TOML keys require, and omit an empty table."""
        values: dict[str, Any] = values_of(self)
        by_led = values.pop("exposures_by_led", {})
        if by_led:
            values["exposures_by_led"] = {str(led): own for led, own in by_led.items()}
        return values

    def exposures_of(self, led: int) -> tuple[float, ...]:
        """Return the exposure times of an LED of the plan, one for each bracket, microseconds."""
        return self.exposures_by_led.get(led, self.exposures_us)

    def exposure_us(self, led: int, bracket: int) -> float:
        """Return the exposure time of an LED of the plan in a bracket, microseconds."""
        return self.exposures_of(led)[bracket]

    @property
    def distinct_exposures_us(self) -> tuple[float, ...]:
        """All different exposure times of the plan, in the order of brackets and LEDs."""
        brackets = zip(*map(self.exposures_of, self.leds), strict=True)
        return tuple(dict.fromkeys(chain.from_iterable(brackets)))

    def check(self, led_count: int, dead_leds: Iterable[int] = ()) -> None:
        """Check that the board has all LEDs of the plan and that they work.

        Parameters
        ----------
        led_count
            Number of LEDs of the board.
        dead_leds
            LEDs that do not work; `without` leaves them out.

        Raises
        ------
        DataError
            If the plan contains an LED that the board lacks or that is dead.
        """
        for led in self.leds:
            if led >= led_count:
                raise DataError(
                    f"the plan's LED {led} does not exist, the board has 0 to {led_count - 1}; "
                    "correct leds"
                )
        dead = sorted(set(self.leds) & set(dead_leds))
        if dead:
            raise DataError(
                f"the plan's LED {dead[0]} is marked dead in the rig file; leave it out of leds"
            )

    def without(self, dead_leds: Iterable[int]) -> tuple[CapturePlan, tuple[int, ...]]:
        """Leave out LEDs that do not work.

        Returns
        -------
        plan
            The plan with the other LEDs.
        left_out
            The LEDs that were left out, in the order of the plan.

        Raises
        ------
        DataError
            If no LED is left.
        """
        dead = set(dead_leds)
        left_out = tuple(led for led in self.leds if led in dead)
        if not left_out:
            return self, ()
        if len(left_out) == len(self.leds):
            raise DataError(
                "plan: every LED of leds is marked dead in the rig file; repair the rig"
            )
        kept = {led: own for led, own in self.exposures_by_led.items() if led not in dead}
        leds = tuple(led for led in self.leds if led not in dead)
        return self.changed(leds=leds, exposures_by_led=kept), left_out

    def changed(self, **values: Any) -> CapturePlan:
        """Return a plan with other values of the given fields.

        Raises
        ------
        DataError
            If the result is not a valid plan.
        """
        return validated(CapturePlan, {**self.model_dump(), **values}, Path("plan"))

    def shots(self) -> tuple[PlannedShot, ...]:
        """Return the shots in the order in which they are taken.

        These are dark frames, ambient frames, lights, and flats. Repeats of the first light are
        after all lights, and after every `repeat_every` of them.

        The exposure time changes as rarely as possible, because cameras take time for it: first
        each LED's longest exposure, then its next, and within these all LEDs of one exposure time
        together. So the light of an LED is known before a frame that may be too short to show it.
        """
        roles: tuple[tuple[Role, bool], ...] = (("dark", self.dark), ("ambient", self.ambient))
        unlit = [
            PlannedShot(role, None, index, 0, exposure_us)
            for role, wanted in roles
            if wanted
            for index, exposure_us in enumerate(self.distinct_exposures_us)
        ]
        ranks = range(len(self.exposures_us))
        lit = [
            PlannedShot("light", led, bracket, repeat, self.exposure_us(led, bracket))
            for rank in ranks
            for repeat in range(self.repeats)
            for led, bracket in self._by_exposure(rank)
        ]
        flats = [
            PlannedShot("flat", led, bracket, number, self.exposure_us(led, bracket))
            for rank in ranks
            for number, led in enumerate(self._flat_leds())
            for bracket in [self._from_longest(led)[rank]]
        ]
        watched: list[PlannedShot] = []
        for number, ends in enumerate(self.lights_before_repeats):
            begins = len(watched) - number
            again = replace(lit[0], role="repeat", repeat=number)
            watched += [*lit[begins:ends], again]
        return (*unlit, *(watched if self.repeat else lit), *flats)

    @property
    def lights_before_repeats(self) -> tuple[int, ...]:
        """Number of lights that are taken before each repeat."""
        if not self.repeat:
            return ()
        count = len(self.leds) * len(self.exposures_us) * self.repeats
        return (*range(self.repeat_every or count, count, self.repeat_every or count), count)

    def _from_longest(self, led: int) -> list[int]:
        """Return the brackets sorted by the LED's exposure time, longest first."""
        exposures_us = self.exposures_of(led)
        return sorted(range(len(exposures_us)), key=lambda bracket: -exposures_us[bracket])

    def _by_exposure(self, rank: int) -> list[tuple[int, int]]:
        """Return (LED, bracket of this rank) pairs, grouped by exposure time."""
        together: dict[float, list[tuple[int, int]]] = {}
        for led in self.leds:
            bracket = self._from_longest(led)[rank]
            together.setdefault(self.exposure_us(led, bracket), []).append((led, bracket))
        return [shot for shots in together.values() for shot in shots]

    def _flat_leds(self) -> list[int]:
        return [self.leds[number * len(self.leds) // self.flats] for number in range(self.flats)]


def read_plan(path: Path) -> CapturePlan:
    r"""Read a plan from a TOML file whose keys are the fields of `CapturePlan`.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If it is not TOML, or a key is unknown or missing, or a value is out of range.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition import read_plan
    >>> _ = Path("plan.toml").write_text('leds = "0-35"\nexposures_us = [10000.0]\n')
    >>> read_plan(Path("plan.toml"))
    CapturePlan(36 LEDs, 1 bracket, 38 shots)
    """
    return read_toml(CapturePlan, path)


@dataclass(frozen=True)
class PlanEstimate:
    """Cost of a plan.

    Parameters
    ----------
    shots
        Number of frames.
    exposure_s
        Sum of the exposure times, seconds.
    seconds
        Total duration: exposure times plus the overhead of each frame.
    bytes
        Size of the uncompressed frames.
    """

    shots: int
    exposure_s: float
    seconds: float
    bytes: int


def estimate_plan(
    plan: CapturePlan, *, width: int, height: int, frame_s: float = 0.0
) -> PlanEstimate:
    """Estimate the cost of a plan without retakes.

    Parameters
    ----------
    plan
        The plan.
    width, height
        Size of a frame of 16-bit samples, pixels.
    frame_s
        Overhead of a frame in addition to its exposure, seconds: settling, readout, commands.

    Examples
    --------
    >>> from acquisition import CapturePlan
    >>> from acquisition.plan import estimate_plan
    >>> plan = CapturePlan(leds="0-35", exposures_us=(10_000.0,))
    >>> estimate_plan(plan, width=640, height=512)
    PlanEstimate(shots=38, exposure_s=0.38, seconds=0.38, bytes=24903680)
    """
    shots = plan.shots()
    exposure_s = sum(shot.exposure_us or 0.0 for shot in shots) / 1e6
    size = len(shots) * frame_bytes(width, height)
    return PlanEstimate(len(shots), exposure_s, exposure_s + len(shots) * frame_s, size)


def frame_bytes(width: int, height: int) -> int:
    """Return the bytes of an uncompressed frame with one 16-bit sample per pixel."""
    return 2 * width * height
