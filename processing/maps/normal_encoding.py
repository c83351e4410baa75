"""How an image encodes normals: the code of zero, a transfer curve, a missing third component."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from acquisition import SRGB, TransferCurve
from rig import Notice
from rig.arrays import Float32, Float64, Floating

# Codes of 8 bits per unit, if 0 and 255 are -1 and 1, and the code of zero then.
_HALF: Final = 127.5
# Codes of zero and per unit of the encodings that programs write, for instance n * 127 + 128
# rounded, or n * 127.5 + 127.5 rounded down, which is as if zero were 127.
_CODES_OF_ZERO: Final = (127.5, 128.0, 127.0)
_CODES_PER_UNIT: Final = (127.5, 127.0, 128.0)
# An encoding is that of the map if rounding explains all but this share of the vectors (components
# of 1 may be cut off), and leaves at least so many more unexplained by any other code of zero.
_UNEXPLAINED: Final = 0.05
_MORE: Final = 10
# A component of this share of the pixels is zero if its code is this many times as frequent as both
# neighbours.
_MANY: Final = 0.01
_PEAK: Final = 4.0
# Vectors of a map with a curve become unit by undoing it: the mean error of their length falls by
# this factor. That of a map without one, or with vectors of other lengths, hardly changes.
_FALLS: Final = 3.0
# The mean error of the length by rounding to 8 bits is below this.
_ROUNDED: Final = 0.003
# That of JPEG files of low quality is below this.
_LOSSY: Final = 0.05
_MOST_TRIED: Final = 1 << 13
# The curves of screens have at least this exponent.
_SCREEN: Final = 1.8
# Vectors are compared in so many groups of similar red and green per channel.
_GROUPS: Final = 16
# Components of two channels contradict a constant third one by more codes than rounding.
_CODES: Final = 2.0
_SAME: Final = 1e-5


_STEPS = np.linspace(0, 1, 1025)
# The curve of values that were taken for sRGB colours and converted to light.
_LINEARISED: Final = TransferCurve.table(np.stack([SRGB.light(_STEPS), _STEPS], axis=1))


class NormalEncoding(NamedTuple):
    """What decoding to -1 ... 1 leaves to do.

    Parameters
    ----------
    lacks_z
        Whether the third component is missing and follows from the others.
    curve
        Transfer curve of the values, or None.
    zero
        Decoded value that means zero, in all components; None if it is not visible.
    zeros
        Decoded values of x and of y that mean zero while all others keep their values; NaN if there
        is no such value.
    off_unit
        Mean difference of the lengths from 1, for vectors that no encoding explains.
    """

    lacks_z: bool = False
    curve: TransferCurve | None = None
    zero: float | None = 0.0
    zeros: tuple[float, float] = (np.nan, np.nan)
    off_unit: float = 0.0

    def apply(self, vectors: Float32) -> None:
        """Change decoded vectors ``(..., 3)`` in place; their lengths are not yet 1."""
        if self.curve is not None:
            vectors[...] = self.curve.light(np.clip(vectors / 2 + 0.5, 0, 1)) * 2 - 1
        if self.zero:
            vectors -= np.float32(self.zero)
        for component, zero in enumerate(self.zeros):
            if np.isfinite(zero):
                part = vectors[..., component]
                part[np.abs(part - np.float32(zero)) < _SAME] = 0
        if self.lacks_z:
            x, y = vectors[..., 0], vectors[..., 1]
            vectors[..., 2] = np.sqrt(np.maximum(1 - x * x - y * y, 0))

    def notices(self, where: str) -> list[Notice]:
        """Return notices about what differs from the usual encoding."""
        texts = []
        if self.lacks_z:
            texts.append("blue is the same everywhere, so z is computed from red and green")
        if self.curve is not None:
            kind = self.curve.exponent
            name = "the sRGB curve" if self.curve == SRGB else "the inverse of the sRGB curve"
            name = name if kind is None else f"a power curve of exponent {kind:.3g}"
            texts.append(f"the values have {name}, which is undone: vectors then have unit length")
        if self.zero:
            code = round(_HALF + self.zero * _HALF)
            texts.append(
                f"the 8-bit code of zero is {code}, not 127.5: vectors then have unit length"
            )
        if self.off_unit > _LOSSY:
            texts.append(
                f"the lengths of the vectors differ from 1 by {self.off_unit:.1%} on average: they "
                "were filtered, or are in an unknown encoding"
            )
        elif self.zero is None and not np.isfinite(self.zeros).any():
            texts.append(
                "whether the 8-bit code of zero is 127.5, 127 or 128 is not visible: the surface "
                "may be tilted by 0.2 degrees in both directions"
            )
        named = [
            f"{name} {_HALF + zero * _HALF:.0f}"
            for name, zero in zip(("red", "green"), self.zeros, strict=True)
            if np.isfinite(zero)
        ]
        if named:
            texts.append(f"the 8-bit code of many pixels, {' and '.join(named)}, is read as zero")
        return [Notice("normals-encoding", text, where, "info") for text in texts]


def normal_encoding(vectors: Float32) -> NormalEncoding:
    """Find out how decoded vectors ``(N, 3)``, some of those of a map, were encoded."""
    drawn = vectors[(np.abs(vectors - vectors[:, :1]) > _SAME).any(1)].astype(np.float64)
    if not len(drawn):
        return NormalEncoding()
    codes = drawn[:, :2] * _HALF + _HALF
    eight_bits = np.abs(codes - np.rint(codes)).max() < 0.01
    if _lacks_z(drawn):
        # With a screen's curve, blue of a shallow map is 1 everywhere, red and green far from half.
        curve = _curve(drawn) if drawn[0, 2] > 1 - _SAME else None
        if curve is not None and (curve.exponent or _SCREEN) >= _SCREEN:
            return NormalEncoding(curve=curve)
        # Flat parts may be grey.
        zeros = _peak(vectors[:, 0]), _peak(vectors[:, 1])
        return NormalEncoding(lacks_z=True, zero=None if eight_bits else 0.0, zeros=zeros)
    zeros = _peak(drawn[:, 0]), _peak(drawn[:, 1])
    keys = np.rint((drawn + 1) * 65535).astype(np.int64) @ [1 << 40, 1 << 20, 1]
    distinct = drawn[np.unique(keys, return_index=True)[1]]
    possible = _zeros(distinct)
    if len(possible) == 1:
        zero = possible[0]
        return NormalEncoding(zero=zero) if zero else NormalEncoding(zeros=zeros)
    curve = None if possible else _curve(distinct)
    if curve is not None:
        return NormalEncoding(curve=curve)
    return NormalEncoding(
        zero=None if eight_bits else 0.0, zeros=zeros, off_unit=_off_unit(distinct)
    )


def _lacks_z(vectors: Float64) -> bool:
    x, y, z = vectors.T
    if np.ptp(z) > _SAME or max(np.ptp(x), np.ptp(y)) < _SAME:
        return False
    square = x * x + y * y
    off = np.abs(np.sqrt(np.maximum(1 - square, 0)) - z) * _HALF
    fits, contradicts = square < 1 + _CODES / _HALF, off > _CODES
    return bool(fits.mean() > 0.99 and contradicts.mean() > 0.01)


def _curve(vectors: Float64) -> TransferCurve | None:
    """Return the transfer curve without which the vectors have unit length, if there is one."""

    def error(curve: TransferCurve | None) -> float:
        """Return the mean error of the length of groups, in which noise and JPEG cancel out."""
        read = vectors if curve is None else curve.light(values) * 2 - 1
        off = np.bincount(group, np.linalg.norm(read, axis=1) - 1)
        return float(np.abs(off).sum() / len(vectors))

    vectors = vectors[:: 1 + len(vectors) // _MOST_TRIED]
    if len(vectors) < _MORE:
        return None
    values = np.clip(vectors / 2 + 0.5, 0, 1)
    red, green = np.minimum(values[:, :2] * _GROUPS, _GROUPS - 1).astype(np.int64).T
    group = red * _GROUPS + green
    plain = error(None)
    if plain < _ROUNDED:
        return None
    exponents = np.geomspace(0.4, 2.6, 61)
    errors = [error(TransferCurve.power(float(each))) for each in exponents]
    around = float(exponents[int(np.argmin(errors))])
    finer = [TransferCurve.power(float(around * each)) for each in np.geomspace(0.97, 1.03, 31)]
    best = min((SRGB, _LINEARISED, *finer), key=error)
    return best if error(best) < plain / _FALLS else None


def _off_unit(vectors: Float64) -> float:
    return float(np.abs(np.linalg.norm(vectors, axis=1) - 1).mean())


def _zeros(vectors: Float64) -> list[float]:
    """Return the decoded values of zero with which rounding explains z best, none without one."""
    length = np.linalg.norm(vectors, axis=1)
    codes = vectors[(length > 0.5) & (length < 1.5)] * _HALF + _HALF
    steps = np.diff(np.unique(codes))
    half = float(steps[steps > _SAME].min(initial=1.0)) / 2
    wrong = [
        min(_unexplained(codes, zero, scale, half) for scale in _CODES_PER_UNIT)
        for zero in _CODES_OF_ZERO
    ]
    if min(wrong) > _UNEXPLAINED * len(codes):
        return []
    close = [count < min(wrong) + _MORE for count in wrong]
    return [zero / _HALF - 1 for zero, kept in zip(_CODES_OF_ZERO, close, strict=True) if kept]


def _unexplained(codes: Float64, zero: float, scale: float, half: float) -> int:
    """Return for how many unit vectors x and y, rounded, do not allow the third component."""
    away = np.abs(codes - zero)
    inner, outer = np.maximum(away[:, :2] - half, 0) / scale, (away[:, :2] + half) / scale
    largest = scale * np.sqrt(np.maximum(1 - (inner * inner).sum(1), 0)) + half
    least = scale * np.sqrt(np.maximum(1 - (outer * outer).sum(1), 0)) - half
    z = away[:, 2]
    return int(np.count_nonzero((z > largest + _SAME) | (z < least - _SAME)))


def _peak(values: Floating) -> float:
    """Return the value next to zero that is far more frequent than its neighbours, or NaN."""
    code = 1 / _HALF
    places = np.array([-1.5, -0.5, 0.5, 1.5]) * code
    counts = [np.count_nonzero(np.abs(values - place) < _SAME) for place in places]
    for i in (1, 2):
        if counts[i] > _MANY * len(values) and counts[i] > _PEAK * max(
            counts[i - 1], counts[i + 1]
        ):
            return float(places[i])
    return np.nan
