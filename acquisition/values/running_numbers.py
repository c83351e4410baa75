"""Running numbers in the names of images, and the order that they show."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from acquisition._errors import DataError
from acquisition.values.image_names import light_id

# A date with a time of day, also with a fraction of seconds: a clock, not a running number.
_CLOCK: Final = re.compile(
    r"(?<!\d)(?:19|20)\d\d[-_. ]?(?:0[1-9]|1[0-2])[-_. ]?(?:0[1-9]|[12]\d|3[01])"
    r"(?:(?:[-_. T]|at)*(?:[01]\d|2[0-3])[-_.:h]?[0-5]\d[-_.:m]?[0-5]\d(?:[-_.]?\d{3})?)(?!\d)",
    re.IGNORECASE,
)
# Digits of a clock with milliseconds.
_CLOCK_DIGITS: Final = 17
# Longer numbers are clocks or identifiers.
_MOST_DIGITS: Final = 7
# Cameras count to 9999, also where they write more digits (DSC09999).
_CAMERA_DIGITS: Final = 4
# Frame numbers of 16 bits.
_MOST_OF_BITS: Final = 65_535
# Numbers of two digits are those of LEDs rather than of a counter that restarts.
_COUNTER_DIGITS: Final = 3
# A series that contains every fourth number, or more of them, is one recording.
_SPARSEST: Final = 4
# A series that covers more than a fifth of the counter may have any gaps.
_WIDEST: Final = 5


class Numbered(NamedTuple):
    """A number in the name of an image.

    Parameters
    ----------
    series
        The text around it, in lower case.
    value
        The number; of a clock, its digits.
    digits
        How many digits it is written with, 0 for a clock.
    """

    series: str
    value: int
    digits: int


def numbers_in(name: str) -> list[Numbered]:
    """Return the numbers in a name: those outside of clocks, then the last clock.

    A clock is a date with a time of day.
    """
    stem = light_id(name)
    bare = _CLOCK.sub("", stem)
    found = [
        Numbered(f"{bare[: run.start()]}#{bare[run.end() :]}", int(run[0]), len(run[0]))
        for run in re.finditer(r"[0-9]{1,18}", bare)
    ]
    for clock in list(_CLOCK.finditer(stem))[-1:]:
        digits = re.sub(r"\D", "", clock[0]).ljust(_CLOCK_DIGITS, "0")
        found.append(Numbered(_CLOCK.sub("@", stem), int(digits), 0))
    return found


def running_number(name: str) -> Numbered | None:
    """Return the running number of a file, or None if its name has none.

    The number is the last one in the name, except for clocks and numbers of more than seven digits.
    """
    numbers = [number for number in numbers_in(name) if number.digits]
    return numbers[-1] if numbers and numbers[-1].digits <= _MOST_DIGITS else None


def numbers_of(names: Sequence[str]) -> list[Numbered]:
    """Return the first number of each name that differs between all; none without one."""
    runs = [numbers_in(name) for name in names]
    for place in range(min(map(len, runs), default=0)):
        column = [run[place] for run in runs]
        if len({number.value for number in column}) == len(column):
            return column
    return []


def start_of(numbers: Sequence[Numbered]) -> tuple[int, bool]:
    """Return the place of the earliest of numbers in rising order, and whether it is certain.

    A counter restarts after its highest number (9999, 0001), so high numbers may come before low
    ones. They do if the series is then dense, at least a fourth of its numbers; and may do if it
    then covers less than a fifth of the counter. Otherwise the place is 0.
    """
    if len(numbers) < 2 or not (counter := _counter(numbers[0], numbers[-1])):
        return 0, True
    gap, start = max(
        (later.value - earlier.value, place)
        for place, (earlier, later) in enumerate(pairwise(numbers), 1)
    )
    span = counter - gap
    if span * _WIDEST > counter:
        return 0, True
    return start, numbers[-1].digits >= _COUNTER_DIGITS and span <= _SPARSEST * len(numbers)


def turnover(numbers: Sequence[Numbered]) -> int:
    """Return by how much numbers below the first are too low; 0 if the numbers do not restart."""
    rising = sorted(numbers, key=lambda number: number.value)
    start, _ = start_of(rising)
    if not start or list(numbers) != [*rising[start:], *rising[:start]]:
        return 0
    return _counter(rising[0], rising[-1])


def steps_between(earlier: Numbered, later: Numbered) -> int:
    """Return how many shots later a running number is; the numbers of a counter restart."""
    step = later.value - earlier.value
    if max(earlier.digits, later.digits) >= _COUNTER_DIGITS:
        counter = _counter(*sorted((earlier, later), key=lambda number: number.value))
        around = step - counter if step > 0 else step + counter
        if abs(around) * _WIDEST <= counter:
            return around
    return step


def _counter(lowest: Numbered, highest: Numbered) -> int:
    """Return how many numbers a counter has; 0 if these numbers are not of one that restarts.

    A counter runs to 9999 from 0, or from 1 if no number is 0, or over 16 bits. The number of its
    digits is constant, except for 16 bits.
    """
    digits = highest.digits
    if lowest.value == 0 and highest.value == _MOST_OF_BITS:
        return _MOST_OF_BITS + 1
    if lowest.digits != digits or not 1 < digits <= _MOST_DIGITS:
        return 0
    if highest.value < 10**_CAMERA_DIGITS:
        digits = min(digits, _CAMERA_DIGITS)
    highest_number: int = 10**digits - 1
    return highest_number if lowest.value else highest_number + 1


def shots_after(earlier: str, later: str) -> int | None:
    """Return how many shots a file comes after another by number; None in different series."""
    one, two = running_number(earlier), running_number(later)
    if one is None or two is None or one.series != two.series:
        return None
    return steps_between(one, two)


def order_doubt(names: Sequence[str]) -> str:
    """Return why the order of images cannot be known from their names; empty if it can."""
    numbers = numbers_of(names)
    if not numbers or any(a.value > b.value for a, b in pairwise(numbers)):
        return ""  # listed in this order, or a counter that certainly restarted
    start, certain = start_of(numbers)
    if certain:
        return ""
    low, high = f"{names[0]} to {names[start - 1]}", f"{names[start]} to {names[-1]}"
    return (
        f"{low} may have been taken before or after {high}, because numbers restart: rename the "
        "images in order, or list them with their lights in an .lp file"
    )


def pair_by_number(lights: Sequence[str], images: Sequence[str]) -> list[int]:
    """Return the index of the light of each image, if the names of both differ.

    The light is that with the number of the image, if both have the same numbers, or else the one
    at the same place.

    Parameters
    ----------
    lights
        Names; empty if the lights have none.
    images
        Names, as many as lights.

    Raises
    ------
    DataError
        If the order of the images cannot be known, or contradicts the numbers of the lights.
    """
    there, here = numbers_of(lights), numbers_of(images)
    rows = {number.value: row for row, number in enumerate(there)}
    if there and rows.keys() == {number.value for number in here}:
        return [rows[number.value] for number in here]
    if doubt := order_doubt(images):
        raise DataError(doubt)
    places = list(range(len(images)))
    if there and here and (row := _contradiction(_unrolled(there), _unrolled(here))) is not None:
        raise DataError(
            f"by order, the light {lights[row]} would belong to the image {images[row]}, which "
            "their numbers contradict: name the lights after the images, or give lights without "
            "names in the order of the images"
        )
    return places


def _unrolled(numbers: Sequence[Numbered]) -> list[int]:
    """Return numbers that keep rising after a counter restarted."""
    more, first = turnover(numbers), numbers[0].value
    return [number.value + (more if number.value < first else 0) for number in numbers]


def _contradiction(lights: Sequence[int], images: Sequence[int]) -> int | None:
    """Return the first place at which numbers contradict the order; None without one.

    Another first number is no contradiction, nor are numbers of which none agree, or numbers of
    lights that are too sparse for running numbers, such as angles.
    """
    if max(lights) - min(lights) >= _SPARSEST * len(lights):
        return None
    offsets = [light - image for light, image in zip(lights, images, strict=True)]
    if 0 in offsets and any(offsets):
        return next(place for place, offset in enumerate(offsets) if offset)
    for place in range(1, len(offsets)):
        if (lights[place] > lights[place - 1]) != (images[place] > images[place - 1]):
            return place
    return None


def natural(name: str) -> tuple[object, ...]:
    """Return a key that sorts names in natural order, by the value of their numbers."""
    return tuple(
        (0, int(part), "") if part.isdecimal() else (1, 0, part.casefold())
        for part in re.split(r"(\d+)", name)
        if part
    )


def in_order(written_s: Mapping[str, float]) -> list[str]:
    """Return names by series, in order of their first file; within a series by number.

    Names with a clock are one series, in natural order. Any other name without a running number is
    a series of its own.

    Parameters
    ----------
    written_s
        Time at which each file was written, by name.
    """
    series: dict[str, list[str]] = {}
    for name in sorted(written_s, key=natural):
        numbered = running_number(name)
        clock = "clock" if _CLOCK.search(name) else name
        series.setdefault(clock if numbered is None else numbered.series, []).append(name)
    runs = [_turned(names, written_s) for names in series.values()]
    runs.sort(key=lambda names: (min(written_s[name] for name in names), natural(names[0])))
    return [name for names in runs for name in names]


def _turned(names: list[str], written_s: Mapping[str, float]) -> list[str]:
    """Return a series with high numbers first if its counter restarted, by number and time."""
    numbers = [number for name in names if (number := running_number(name))]
    start, _ = start_of(numbers)
    if len(numbers) < len(names) or not start or written_s[names[start]] > written_s[names[0]]:
        return names
    return [*names[start:], *names[:start]]
