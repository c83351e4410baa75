"""Which lights of two calibrations are the same."""

from __future__ import annotations

from collections.abc import Iterator

from acquisition import DataError, Lights
from rig import Notice, pluralize

_NAMED = 8


def matched_lights(a: Lights, b: Lights) -> tuple[Lights, Lights, tuple[Notice, ...]]:
    """Return the lights that both have, in the order of ``a``, and notices about the others.

    A calibration may have left out lights. So if it names the frames of its lights, the other one
    may have more of them.

    Raises
    ------
    DataError
        If the numbers or names of the lights differ, and not because a calibration left out lights.
    """
    if len(a) == len(b):
        try:
            order, by_name = b.match(a.ids)
        except DataError:
            pass
        else:
            if by_name:
                return a, b.take(order), ()
            text = (
                "lights with different names are matched by order "
                f"({b.ids[0]} to {a.ids[0]} and so on)"
            )
            return a, b, (Notice("lights-matched-by-order", text),)
    places = [_place(name, b) for name in a.ids]
    both = [n for n, place in enumerate(places) if place is not None]
    order = [place for place in places if place is not None]
    only_a = [name for name, place in zip(a.ids, places, strict=True) if place is None]
    only_b = [name for n, name in enumerate(b.ids) if n not in order]
    left_out = (not only_a or b.calibrated is not None) and (not only_b or a.calibrated is not None)
    if not left_out or len(set(order)) < len(order) or 2 * len(both) < max(len(a), len(b)):
        raise _different(a, b, only_a)
    return a.take(both), b.take(order), tuple(_missing(only_a, only_b))


def _place(name: str, lights: Lights) -> int | None:
    """Return the index of the light with a name, or None."""
    try:
        (place,), by_name = lights.match([name])
    except DataError:
        return None
    return place if by_name else None


def _missing(only_a: list[str], only_b: list[str]) -> Iterator[Notice]:
    for names, other in ((only_a, "second"), (only_b, "first")):
        if names:
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            text = f"the {other} calibration has no light {', '.join(names[:_NAMED])}{more}"
            yield Notice("lights-not-compared", f"{text}: not compared")


def _different(a: Lights, b: Lights, only_a: list[str]) -> DataError:
    if len(a) != len(b):
        text = f"the first calibration has {pluralize(len(a), 'light')}, the second {len(b)}"
    else:
        missing = only_a[0] if only_a else a.ids[0]
        text = f"the calibrations name their lights differently: the second has no {missing}"
    return DataError(f"{text}: compare calibrations of the same lights")
