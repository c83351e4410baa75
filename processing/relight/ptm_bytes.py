"""Functions of pixels as bytes of a polynomial texture map; those of a pixel are chosen together.

A file has one scale and one bias for each of the six coefficients, and one byte for each
coefficient and each colour of a pixel. The value of a pixel is ``colour * function``, so the same
values have many bytes: with a colour that is twice as bright, the function is half as large. With
the darkest colour, the function fills the range of its bytes, and its rounding counts least.

The deviation of a value is ``e0 + e1 u + e2 v + e3 u² + e4 uv + e5 v²`` with the rounding errors
``e``. Its odd part is at most ``hypot(e1, e2)`` over all lights. Its even part along a direction is
``e0 + r² (m + n cos(2 phi))``, with extremes 0 and ``m +- n``; ``e0`` puts their middle at 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from rig import in_threads
from rig.arrays import Float32, Float64, UInt8
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Shares of the pixels outside the ranges whose relations the six scales have; the best one counts.
_OUTSIDE = (1e-5, 1e-4, 1e-3)
_SOME = 5_000
_MOST = 300_000
# So that the brightest pixels have several colours to choose from.
_SPARE = 1.15
_GOOD = 0.85 / 255  # a deviation that needs no better bytes
_FAIR = 1 / 255  # one for which not all colours are tried
_TRIES = 32
_PEAK = 0.8
_DIAMETERS = 16
_COS = np.cos(np.pi * np.arange(_DIAMETERS) / _DIAMETERS)
_SIN = np.sin(np.pi * np.arange(_DIAMETERS) / _DIAMETERS)


class PtmBytes(NamedTuple):
    """Functions ``(samples - bias) * scale``, in the order of the basis, times ``colour / 255``.

    Parameters
    ----------
    samples
        ``(P, 6)`` bytes.
    colour
        ``(P, 3)`` bytes.
    scale
        ``(6,)`` positive.
    bias
        ``(6,)`` whole numbers, 0 to 255.
    bound
        ``(P,)`` limit of the deviation from the values under any light.
    """

    samples: UInt8
    colour: UInt8
    scale: Float64
    bias: Float64
    bound: Float32


def ptm_bytes(coefficients: Float32, colour: Float32 | None) -> PtmBytes:
    """Round functions ``(P, 6)`` of the basis ``ptm`` and their ``(P, 3)`` colours.

    Without colours, each function is rounded as it is, and its colour is white.
    """
    tint = np.ones((len(coefficients), 3), np.float32) if colour is None else colour
    fixed = colour is None
    values = coefficients * np.abs(tint).max(axis=1, keepdims=True)
    some = values[:: 1 + len(values) // _MOST]
    extremes = values.min(axis=0), values.max(axis=0)
    ends_at = [values.argmin(axis=0), values.argmax(axis=0)]
    few = np.unique(np.concatenate([*ends_at, np.arange(0, len(values), 1 + len(values) // _SOME)]))
    shares = [*_OUTSIDE, *(1 - share for share in _OUTSIDE)]
    low, high = np.quantile(some, shares, axis=0).reshape(2, len(_OUTSIDE), 6)
    offered = [extremes, *zip(low, high, strict=True)]
    scales = [_scales(extremes, ends, fixed) for ends in offered]
    errors = [
        np.sum(_rounded(coefficients[few], tint[few], *each, fixed).bound.astype(np.float64) ** 12)
        for each in scales
    ]
    return _rounded(coefficients, tint, *scales[int(np.argmin(errors))], fixed)


def _scales(
    extremes: tuple[Float32, Float32], ends: tuple[Float32, Float32], fixed: bool
) -> tuple[Float64, Float64]:
    """Return scales and biases with the relations of `ends`, so that no pixel is out of range."""
    low = np.minimum(ends[0].astype(np.float64), 0)
    high = np.maximum(ends[1].astype(np.float64), 0)
    spare = 1.0
    if not fixed:
        beyond = [
            value / end
            for side, of in ((low, extremes[0]), (high, extremes[1]))
            for value, end in zip(of, side, strict=True)
            if end != 0
        ]
        spare = _SPARE * max([1.0, *beyond])
    scale = spare * (high - low) / 254
    scale[scale == 0] = 1.0
    # The text of the scale in the file, for values of 0 to 255, is what readers multiply by.
    scale = np.array([float(f"{255 * step:.9g}") / 255 for step in scale])
    return scale, np.ceil(-spare * low / scale)


def _rounded(
    coefficients: Float32, tint: Float32, scale: Float64, bias: Float64, fixed: bool
) -> PtmBytes:
    count = len(coefficients)
    samples, colour = np.zeros((count, 6), np.uint8), np.zeros((count, 3), np.uint8)
    bound = np.zeros(count, np.float32)
    coefficients, tint = np.ascontiguousarray(coefficients), np.ascontiguousarray(tint)
    in_threads(_round, count, coefficients, tint, scale, bias, fixed, samples, colour, bound)
    return PtmBytes(samples, colour, scale, bias, bound)


@numba.njit(nogil=True, cache=True)
def _round(
    first: int,
    last: int,
    coefficients: Float32,
    tint: Float32,
    scale: Float64,
    bias: Float64,
    fixed: bool,
    samples: UInt8,
    colour: UInt8,
    bound: Float32,
) -> None:
    """Try colours of each pixel, and keep the bytes whose largest deviation is smallest."""
    place = np.zeros(6)
    found = np.zeros(6)
    hue = np.zeros(3)
    for p in range(first, last):
        brightest = max(tint[p, 0], tint[p, 1], tint[p, 2])
        for i in range(6):
            samples[p, i] = np.uint8(bias[i])
        if not brightest > 0:
            continue
        gray = True
        for k in range(3):
            hue[k] = max(tint[p, k], 0.0) / brightest
            gray = gray and hue[k] == 1.0
        # The darkest colour with which all coefficients are in range.
        darkest = 0.0
        for i in range(6):
            value = coefficients[p, i] * brightest / scale[i]
            room = 255 - bias[i] if value > 0 else -bias[i]
            if value != 0:
                darkest = max(darkest, 255 * value / room) if room != 0 else 255.0
        if not gray:
            # Errors of the colour count less, the larger it is.
            darkest = max(darkest, _PEAK * 255 * coefficients[p, 0] * brightest)
        start = 255 if fixed else int(min(255.0, max(1.0, math.ceil(darkest))))
        smallest = np.inf
        for level in range(start, 256):
            if level > start + _TRIES and smallest < _FAIR:
                break
            share = level / 255
            for i in range(6):
                place[i] = coefficients[p, i] * brightest / (share * scale[i]) + bias[i]
            for i in (1, 2):
                found[i] = min(255.0, max(0.0, np.rint(place[i])))
            odd = math.hypot((found[1] - place[1]) * scale[1], (found[2] - place[2]) * scale[2])
            if smallest < np.inf and odd * share > _GOOD:
                continue
            _nearest(place, scale, found)
            worst = 0.0
            for k in range(1 if gray else 3):
                byte = np.rint(level * hue[k])
                worst = max(worst, _largest(place, found, scale, bias, byte, level * hue[k]))
                if worst >= smallest:
                    break
            if worst < smallest:
                smallest = worst
                bound[p] = worst
                for i in range(6):
                    samples[p, i] = np.uint8(found[i])
                for k in range(3):
                    colour[p, k] = np.uint8(np.rint(level * hue[k]))
                if worst < _GOOD:
                    break


@numba.njit(**PART)
def _nearest(place: Float64, scale: Float64, found: Float64) -> None:
    """Round the even coefficients so that the largest deviation over all lights is small."""
    smallest = np.inf
    for choice in range(8):
        a = min(255.0, max(0.0, math.floor(place[3]) + (choice & 1)))
        b = min(255.0, max(0.0, math.floor(place[4]) + ((choice >> 1) & 1)))
        c = min(255.0, max(0.0, math.floor(place[5]) + ((choice >> 2) & 1)))
        low, high = _extremes(
            (a - place[3]) * scale[3], (b - place[4]) * scale[4], (c - place[5]) * scale[5]
        )
        constant = np.rint(place[0] - (low + high) / (2 * scale[0]))
        constant = min(255.0, max(0.0, constant))
        error = (constant - place[0]) * scale[0]
        worst = max(abs(low + error), abs(high + error))
        if worst < smallest:
            smallest = worst
            found[0], found[3], found[4], found[5] = constant, a, b, c


@numba.njit(**PART)
def _extremes(a: float, b: float, c: float) -> tuple[float, float]:
    """Return the smallest and the largest value of ``a u² + b uv + c v²`` over all lights."""
    middle, half = (a + c) / 2, math.hypot((a - c) / 2, b / 2)
    return min(0.0, middle - half), max(0.0, middle + half)


@numba.njit(**PART)
def _largest(
    place: Float64, found: Float64, scale: Float64, bias: Float64, byte: float, exact: float
) -> float:
    """Limit the deviation of one colour over all lights."""
    e0 = (byte * (found[0] - bias[0]) - exact * (place[0] - bias[0])) * scale[0]
    e1 = (byte * (found[1] - bias[1]) - exact * (place[1] - bias[1])) * scale[1]
    e2 = (byte * (found[2] - bias[2]) - exact * (place[2] - bias[2])) * scale[2]
    e3 = (byte * (found[3] - bias[3]) - exact * (place[3] - bias[3])) * scale[3]
    e4 = (byte * (found[4] - bias[4]) - exact * (place[4] - bias[4])) * scale[4]
    e5 = (byte * (found[5] - bias[5]) - exact * (place[5] - bias[5])) * scale[5]
    worst = abs(e0)
    for way in range(_DIAMETERS):
        u, v = _COS[way], _SIN[way]
        slope, bend = e1 * u + e2 * v, e3 * u * u + e4 * u * v + e5 * v * v
        worst = max(worst, abs(e0 + bend) + abs(slope))
        if abs(slope) < 2 * abs(bend):
            worst = max(worst, abs(e0 - slope * slope / (4 * bend)))
    return float(worst / 255)
