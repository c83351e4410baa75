"""Counter-based random numbers: they depend only on key and counter, not on the order of calls.

SplitMix64 (Steele, Lea and Flood 2014) is used as a hash. `simulator/gentl/dice.h` has the same
functions in C, so that both virtual cameras make the same frames; change both together.
"""

from __future__ import annotations

import math

_MASK = 2**64 - 1
GOLDEN = 0x9E3779B97F4A7C15
MIX_1 = 0xBF58476D1CE4E5B9
MIX_2 = 0x94D049BB133111EB


def stream(*key: int) -> int:
    """Return the state of the stream of random numbers for a key.

    Parameters
    ----------
    key
        Integers, each 0 to 2**64 - 1; their order matters.

    Returns
    -------
    int
        State of 64 bits.
    """
    state = 0
    for part in key:
        state = bits(state, part)
    return state


def bits(state: int, counter: int) -> int:
    """Return the 64 random bits at a position of a stream."""
    x = (state + (counter + 1) * GOLDEN) & _MASK
    x = ((x ^ (x >> 30)) * MIX_1) & _MASK
    x = ((x ^ (x >> 27)) * MIX_2) & _MASK
    return x ^ (x >> 31)


def uniform(state: int, counter: int) -> float:
    """Return a uniform random number between 0 and 1, both excluded."""
    return ((bits(state, counter) >> 12) + 0.5) * 2.0**-52


def normal_pair(state: int, counter: int) -> tuple[float, float]:
    """Return two independent standard normal numbers (Box and Muller).

    They use the positions ``counter`` and ``counter + 1`` of the stream.
    """
    radius = math.sqrt(-2.0 * math.log(uniform(state, counter)))
    turn = 2.0 * math.pi * uniform(state, counter + 1)
    return radius * math.cos(turn), radius * math.sin(turn)
