"""Random numbers by counter: the same for the same key, whoever asks, in whatever order.

SplitMix64 (Steele, Lea and Flood 2014) as a hash. The virtual camera has the same in C
(`simulator/gentl/dice.h`), so that both draw the same frames; change both.
"""

from __future__ import annotations

import math

_MASK = 2**64 - 1
GOLDEN = 0x9E3779B97F4A7C15
MIX_1 = 0xBF58476D1CE4E5B9
MIX_2 = 0x94D049BB133111EB


def stream(*key: int) -> int:
    """Return the state of the stream of random numbers that whole numbers name.

    Parameters
    ----------
    key
        Each 0 to 2**64 - 1; their order counts.

    Returns
    -------
    int
        64 bits.
    """
    state = 0
    for part in key:
        state = bits(state, part)
    return state


def bits(state: int, counter: int) -> int:
    """Return the 64 random bits at a place of a stream."""
    x = (state + (counter + 1) * GOLDEN) & _MASK
    x = ((x ^ (x >> 30)) * MIX_1) & _MASK
    x = ((x ^ (x >> 27)) * MIX_2) & _MASK
    return x ^ (x >> 31)


def uniform(state: int, counter: int) -> float:
    """Return a number evenly between 0 and 1, neither included."""
    return ((bits(state, counter) >> 12) + 0.5) * 2.0**-52


def normal_pair(state: int, counter: int) -> tuple[float, float]:
    """Return two independent standard normal numbers (Box and Muller).

    They take the places ``counter`` and ``counter + 1`` of the stream.
    """
    radius = math.sqrt(-2.0 * math.log(uniform(state, counter)))
    turn = 2.0 * math.pi * uniform(state, counter + 1)
    return radius * math.cos(turn), radius * math.sin(turn)
