"""What the explanation of two calibrations says to people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from acquisition.values import led_of
from calibration.comparison.order import Explanation, Motion
from rig import Notice
from rig.arrays import Float64

_REMEDY = "check the order of wires, images or led_positions_mm"
# A shift or a rotation below these is not worth a word.
_LEAST_MM, _LEAST_DEG = 5e-4, 5e-4
_LEAST_NAMED = 1e-3
_SIDES = {"x": "left and right", "y": "top and bottom"}


def explanation_notices(
    found: Explanation, ids: Sequence[str], rest: Float64, unit: str
) -> Iterator[Notice]:
    """Yield a notice for another order, a mirror image and a common motion.

    Parameters
    ----------
    found
        The explanation.
    ids
        Names of the lights.
    rest
        ``(N,)`` what remains, in ``unit``.
    unit
        ``mm`` for positions, else ``deg``.
    """
    if found.is_reversed:
        text = (
            f"the order is reversed: {ids[0]} is at the place of {ids[len(ids) - 1]} of the other "
            f"calibration, and so on: {_REMEDY}"
        )
        yield Notice("lights-reversed", text)
    if found.mirror:
        text = (
            f"the lights are mirrored: {_SIDES[found.mirror]} are exchanged; check the mounting of "
            "the camera, the axes, and whether the LEDs are counted in the other sense"
        )
        yield Notice("lights-flipped", text)
    yield from _exchanges(found, ids)
    if found.kind != "none":
        median = float(np.median(rest))
        left = f"{median:.2g} {unit}" if median >= _LEAST_NAMED else f"< {_LEAST_NAMED:g} {unit}"
        text = (
            f"all lights {motion_text(found.motion)}: the camera, the board or the plane of the "
            f"object moved; without this motion, half of the differences are within {left}"
        )
        yield Notice("lights-moved-together", text)


def motion_text(motion: Motion) -> str:
    """Return a motion as the end of a sentence about the lights."""
    said = []
    if motion.angle_deg >= _LEAST_DEG:
        said.append(f"turned together by {motion.angle_deg:.3g} deg about {_vector(motion.axis)}")
    length = float(np.linalg.norm(motion.shift_mm))
    if length >= _LEAST_MM:
        said.append(f"shifted together by {length:.3g} mm, {_vector(motion.shift_mm)}")
    return " and ".join(said) or "stayed in place"


def named(ids: Sequence[str]) -> str:
    """Return the names of lights for a sentence: ``LED 7 and 8``, or ``chrome.7 and chrome.8``."""
    leds = [led_of(name) for name in ids]
    plain = all(led is not None for led in leds)
    names = [str(led) for led in leds] if plain else list(ids)
    listed = " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]
    return f"LED {listed}" if plain else listed


def _exchanges(found: Explanation, ids: Sequence[str]) -> Iterator[Notice]:
    cycles = found.exchanged
    if not cycles:
        return
    moved = sum(map(len, cycles))
    if moved > len(ids) / 2:
        first, place = (named([ids[n]]) for n in (cycles[0][0], found.order[cycles[0][0]]))
        text = (
            f"the lights have another order: {moved} of {len(ids)} are at the places of others, "
            f"for example {first} at that of {place}: {_REMEDY}"
        )
    else:
        said = [_exchange(cycle, found, ids) for cycle in cycles]
        text = f"{'; '.join(said)}: {_REMEDY}"
    yield Notice("lights-swapped", text)


def _exchange(cycle: Sequence[int], found: Explanation, ids: Sequence[str]) -> str:
    if len(cycle) == 2:
        return f"{named([ids[n] for n in sorted(cycle)])} are swapped"
    first, place = (named([ids[n]]) for n in (cycle[0], found.order[cycle[0]]))
    among = named([ids[n] for n in sorted(cycle)])
    return f"{among} are exchanged: {first} is at the place of {place}"


def _vector(vector: Float64) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in np.round(vector, 4) + 0.0) + ")"
