"""The transfer curve of an ICC profile (ICC.1:2022; ICC.1:2001-04 for older profiles)."""

from __future__ import annotations

import struct
from typing import Final

import numpy as np

from acquisition._errors import DataError
from acquisition.values.transfer_curve import LINEAR, SRGB, TransferCurve
from rig import UnreadableError
from rig.arrays import Float64
from rig.files import convert_parser_errors

_HEADER: Final = 128
_MOST_TAGS: Final = 200
_MOST_BYTES: Final = 16 << 20
_MOST_POINTS: Final = 65536
# Number of values of each function of a `para` tag.
_PARAMETERS: Final = (1, 3, 4, 5, 7)
# Largest differences of light, relative to white, within which two curves count as equal. Profiles
# round their numbers to 1/65536 and their tables to a few hundred points.
_SAME: Final = 2e-3
_GRID: Final = np.linspace(0, 1, 1025)


def icc_curve(profile: bytes) -> TransferCurve:
    """Return the transfer curve that a profile of RGB or grey images defines.

    Parameters
    ----------
    profile
        The bytes of the profile, possibly damaged.

    Returns
    -------
    TransferCurve
        Light relative to white. A curve within 0.002 of sRGB, of linear or of a power is returned
        as such, any other as a table.

    Raises
    ------
    UnreadableError
        If the profile is damaged, has no curves (profiles of printers have tables of colours), or
        has different curves for red, green and blue.
    """
    if not _HEADER + 4 <= len(profile) <= _MOST_BYTES or profile[36:40] != b"acsp":
        raise UnreadableError("is not one")
    with convert_parser_errors("is damaged"):
        tags = _tags(memoryview(profile))
        names = [name for name in (b"rTRC", b"gTRC", b"bTRC", b"kTRC") if name in tags]
        curves = [_light(tags[name]) for name in names]
    if not curves:
        raise UnreadableError("has no transfer curves")
    light = curves[0]
    if any(np.abs(other - light).max() > _SAME for other in curves[1:]):
        raise UnreadableError("has different curves for red, green and blue")
    return _named(light)


def _tags(profile: memoryview) -> dict[bytes, memoryview]:
    """Return the content of the tags by their signatures, cut to the bytes that there are."""
    (count,) = struct.unpack_from(">I", profile, _HEADER)
    tags = {}
    for index in range(min(count, _MOST_TAGS)):
        name, begin, size = struct.unpack_from(">4sII", profile, _HEADER + 4 + 12 * index)
        tags[name] = profile[begin : begin + size]
    return tags


def _light(tag: memoryview) -> Float64:
    """Return the light of a `curv` or `para` tag at `_GRID`, finite."""
    (kind,) = struct.unpack_from(">4s", tag)
    if kind not in (b"curv", b"para"):
        raise ValueError("a curve of an unknown type")
    light = _sampled(tag) if kind == b"curv" else _parametric(tag)
    if not np.isfinite(light).all():
        raise ValueError("a curve that is not finite")
    return light


def _sampled(tag: memoryview) -> Float64:
    (count,) = struct.unpack_from(">I", tag, 8)
    if count == 0:
        return _GRID
    if count == 1:
        return np.asarray(_GRID ** (struct.unpack_from(">H", tag, 12)[0] / 256))
    if count > _MOST_POINTS or len(tag) < 12 + 2 * count:
        raise ValueError("a curve is cut short")
    table = np.frombuffer(tag, ">u2", count, 12) / 65535
    return np.interp(_GRID, np.linspace(0, 1, count), table)


def _parametric(tag: memoryview) -> Float64:
    (function,) = struct.unpack_from(">H", tag, 8)
    if function >= len(_PARAMETERS):
        raise ValueError("a curve of an unknown function")
    count = _PARAMETERS[function]
    numbers = [number / 65536 for number in struct.unpack_from(f">{count}i", tag, 12)]
    g, a, b, c, d, e, f = (numbers + [0.0] * 7)[:7]
    match function:
        case 0:
            a, d = 1.0, 0.0
        case 1:  # 0 below -b/a
            c, d = 0.0, -b / a
        case 2:  # c below -b/a
            c, d, e, f = 0.0, -b / a, c, c
    with np.errstate(all="ignore"):
        bent = np.maximum(a * _GRID + b, 0) ** g + e
    return np.asarray(np.where(d <= _GRID, bent, c * _GRID + f))


def _named(light: Float64) -> TransferCurve:
    for known in (SRGB, LINEAR):
        if _close(light, known):
            return known
    try:
        # The power through the middle of the curve.
        middle = len(_GRID) // 2
        with np.errstate(all="ignore"):
            power = TransferCurve.power(float(np.log(light[middle]) / np.log(_GRID[middle])))
        if _close(light, power):
            return power
    except DataError:
        pass  # not a power
    rising = np.flatnonzero(light > np.maximum.accumulate(np.concatenate([[0.0], light[:-1]])))
    rising = rising[rising > 0]  # a value just above 0 at the start counts as 0
    points = np.concatenate([[[0.0, 0.0]], np.stack([_GRID[rising], light[rising]], 1)])
    try:
        if rising.size and rising[-1] == len(_GRID) - 1 and abs(light[0]) <= _SAME:
            return TransferCurve.table(points)
    except DataError:
        pass  # the same refusal
    raise UnreadableError("has a curve that does not increase from 0 to 1")


def _close(light: Float64, known: TransferCurve) -> bool:
    # NaN counts as different.
    return bool(np.abs(light - known.light(_GRID)).max() <= _SAME)
