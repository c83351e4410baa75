"""LED numbers as people write them: ``0-35``, ``0-5, 8, 12-10``."""

from __future__ import annotations

import re
from typing import Final

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
    >>> from acquisition import led_numbers
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
