"""Significance of local changes: matched filters of several widths, compared with their errors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import cv2
import numpy as np
from scipy.optimize import brentq

from processing.changes.difference import Difference, enlarged
from rig.arrays import Bool, Float32, Float64

# Standard deviations of the templates in pixels: of spots, and across lines.
SCALES_PX: Final = (0.8, 1.2, 1.8, 2.7, 4.0)
LINES_PX: Final = (0.8, 1.2, 1.8)
# A line consists of 8 spots, and has one of 12 directions.
_STEP_PX, _SPOTS, _DIRECTIONS = 2.0, 8, 12
TURN: Final = math.pi / _DIRECTIONS
# The Gaussian whose standard deviation is that of a line along it.
_LINE_PX: Final = _STEP_PX * _SPOTS / math.sqrt(12)
_REACH: Final = 4.0
# Half of the side of a template.
HALF: Final = 24
# Mean of the square of a standard normal number, bounded by this square.
_BOUND: Final = 4.0
_BOUNDED_MEAN: Final = 0.9199
# Side of a block in samples, every which pixel is a sample, and the standard deviation of the
# neighbourhood whose errors are compared, at least in blocks and in scales of the template.
_SAMPLES, _EVERY, _AROUND, _AROUND_SCALES = 8, 2, 1.5, 12.0
_ROUNDS: Final = 6
# Standard deviation in pixels of the position of an edge of paint, by the pixels that sample it.
_SAMPLED: Final = 0.1
# Share of normal numbers that are closer to 0 than this. Changes widen the tails of the albedo, so
# that these count up to a limit.
_TAIL, _TAIL_REACHES, _WIDEST, _MOST = 0.9973, 3.0, 1.3, 400_000


class Response(NamedTuple):
    """Amplitudes of a template at every pixel.

    Parameters
    ----------
    scale_px
        Standard deviation of the template; of a line, across it.
    angle
        Direction of a line in radians from column to row; None for a spot.
    amplitude
        ``(H, W)`` best amplitude of a template there.
    sigma
        ``(H, W)`` its standard deviation; NaN where it is not known.
    z
        ``(H, W)`` amplitude over standard deviation; 0 where it is not known.
    control
        ``(H, W)`` the same of what no change of a surface causes, see `height_responses`; None for
        the albedo.
    factor
        ``(H, W)`` by how much errors nearby exceed those of the weights.
    """

    scale_px: float
    angle: float | None
    amplitude: Float32
    sigma: Float32
    z: Float32
    control: Float32 | None
    factor: Float32


class _Sums(NamedTuple):
    """Sums over a template: of values, of the control, and of the weights of its squares."""

    found: Float32
    control: Float32 | None
    power: Float32


def height_responses(difference: Difference) -> Iterator[Response]:
    """Return amplitudes of spots and lines of height in pixels.

    A change of a surface has no curl, but errors have as much curl as divergence. What the same
    filter finds in the curl shows how large the errors are nearby.
    """
    for scale in SCALES_PX:
        bell, slope = _kernels(scale)
        column, row = (difference.weight * of for of in difference.slopes)
        power = _correlated(difference.weight, slope**2, bell**2)
        power += _correlated(difference.weight, bell**2, slope**2)
        sums = _Sums(
            _correlated(column, slope, bell) + _correlated(row, bell, slope),
            _correlated(row, slope, bell) - _correlated(column, bell, slope),
            power,
        )
        yield _response(scale, None, sums, difference.weight, power_of(scale, None))
        if scale in LINES_PX:
            for k in range(_DIRECTIONS):
                yield _line(scale, k * TURN, sums, difference.weight)


def albedo_responses(difference: Difference) -> Iterator[Response]:
    """Return amplitudes of spots of the logarithm of the albedo, relative to their surroundings.

    Pixels sample an edge of paint differently in both recordings. This displaces it by parts of a
    pixel, alike for some pixels along the edge: such errors do not average out within a spot.
    """
    weight, values, edge = difference.albedo_weight, difference.log_albedo, difference.albedo_edge
    if weight is None or values is None or edge is None:
        return
    for scale in SCALES_PX:
        bell, wide = _kernels(scale)[0], _kernels(2 * scale)[0]
        displaced = _SAMPLED * _correlated(edge, bell, bell) / bell.sum() ** 2
        # A spot with as much of the opposite around it.
        bell = np.pad(bell, (len(wide) - len(bell)) // 2)
        share = (bell.sum() / wide.sum()) ** 2
        weighted = weight * values
        found = _correlated(weighted, bell, bell) - share * _correlated(weighted, wide, wide)
        power = _correlated(weight, bell**2, bell**2)
        power += share**2 * _correlated(weight, wide**2, wide**2)
        power -= 2 * share * _correlated(weight, bell * wide, bell * wide)
        full = float(np.square(np.outer(bell, bell) - share * np.outer(wide, wide)).sum())
        made = _response(scale, None, _Sums(found, None, power), weight, full)
        sigma = np.asarray(np.hypot(made.sigma, displaced), np.float32)
        yield made._replace(sigma=sigma, z=np.nan_to_num(made.amplitude / sigma))


def _kernels(scale: float) -> tuple[Float64, Float64]:
    """Return a Gaussian with 1 in its middle, and its derivative."""
    reach = math.ceil(_REACH * scale)
    along = np.arange(-reach, reach + 1.0)
    bell = np.exp(-0.5 * np.square(along / scale))
    return bell, -along / scale**2 * bell


def _correlated(values: Float32, across: Float64, down: Float64) -> Float32:
    border = cv2.BORDER_CONSTANT
    return np.asarray(cv2.sepFilter2D(values, cv2.CV_32F, across, down, borderType=border))


def _line(scale: float, angle: float, sums: _Sums, weight: Float32) -> Response:
    """Return the response to a line of spots."""
    found, power = (_added(of, angle) for of in (sums.found, sums.power))
    control = None if sums.control is None else _added(sums.control, angle)
    # The squares of a sum are not the sum of squares.
    full, separate = (power_of(scale, of) for of in (angle, None))
    power = power * np.float32(full / (_SPOTS * separate))
    return _response(scale, angle, _Sums(found, control, power), weight, full)


def _places() -> Float64:
    """Return the distances of the spots of a line from its middle."""
    return np.asarray(_STEP_PX * (np.arange(_SPOTS) - (_SPOTS - 1) / 2), np.float64)


def template(scale: float, angle: float | None) -> tuple[Float64, Float64]:
    """Return the derivatives along columns and rows of a template, see `Response`."""
    row, column = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1].astype(float)
    places = np.zeros(1) if angle is None else _places()
    made = np.zeros((2, *row.shape))
    for at in places:
        offset = (0, 0) if angle is None else _offset(at, angle)
        right, down = column - offset[0], row - offset[1]
        bell = np.exp(-0.5 * (right**2 + down**2) / scale**2)
        made -= np.stack([right, down]) * bell / scale**2
    return made[0], made[1]


def power_of(scale: float, angle: float | None) -> float:
    """Return the sum of the squares of the slopes of a template."""
    return sum(float((of**2).sum()) for of in template(scale, angle))


def _offset(at: float, angle: float) -> tuple[int, int]:
    return int(np.rint(at * math.cos(angle))), int(np.rint(at * math.sin(angle)))


def _added(values: Float32, angle: float) -> Float32:
    """Return sums over the spots of a line."""
    total = np.zeros_like(values)
    height, width = values.shape
    for at in _places():
        right, down = _offset(at, angle)
        here = (
            slice(max(-down, 0), height - max(down, 0)),
            slice(max(-right, 0), width - max(right, 0)),
        )
        there = (
            slice(max(down, 0), height - max(-down, 0)),
            slice(max(right, 0), width - max(-right, 0)),
        )
        total[here] += values[there]
    return total


def _response(
    scale: float, angle: float | None, sums: _Sums, weight: Float32, full: float
) -> Response:
    # Half of a template at least is in the known part.
    known = (weight > 0) & (sums.power > 0.5 * full * weight)
    root = np.sqrt(np.where(known, sums.power, 1))
    z = np.asarray(np.where(known, sums.found / root, 0), np.float32)
    extent = scale if angle is None else math.sqrt(scale * _LINE_PX)
    factor = _local_scale(z, known, extent)
    control = None
    if sums.control is not None:
        control = np.asarray(np.where(known, sums.control / root, 0), np.float32)
        factor = np.maximum(factor, _local_scale(control, known, extent))
    factor *= _tail((z if control is None else control) / factor, known)
    if control is not None:
        control = np.asarray(control / factor, np.float32)
    return Response(
        scale,
        angle,
        np.asarray(np.where(known, sums.found / root**2, 0), np.float32),
        np.asarray(np.where(known, factor / root, np.nan), np.float32),
        np.asarray(z / factor, np.float32),
        control,
        factor,
    )


def _tail(z: Float32, known: Bool) -> np.float32:
    """Return by how much the tails are wider than those of a Gaussian, 1 or more.

    Errors differ from pixel to pixel, which a neighbourhood does not show.
    """
    some = np.abs(z[known])
    if not some.size:
        return np.float32(1)
    reached = np.quantile(some[:: 1 + some.size // _MOST], _TAIL)
    return np.float32(np.clip(reached / _TAIL_REACHES, 1, _WIDEST))


def _local_scale(z: Float32, known: Bool, extent: float) -> Float32:
    """Return the standard deviation of values in the neighbourhood; outliers hardly count."""
    side = _SAMPLES * _EVERY
    square, known_here = np.square(z[::_EVERY, ::_EVERY]), known[::_EVERY, ::_EVERY]
    rows, columns = (-(-length // _SAMPLES) for length in square.shape)
    lengths = zip((rows, columns), square.shape, strict=True)
    pad = [(0, n * _SAMPLES - length) for n, length in lengths]
    around = max(_AROUND, _AROUND_SCALES * extent / side)

    def smooth(values: Float32) -> Float64:
        blocks = np.pad(values, pad).reshape(rows, _SAMPLES, columns, _SAMPLES)
        sums = blocks.sum(axis=(1, 3)).astype(np.float64)
        return np.asarray(cv2.GaussianBlur(sums, (0, 0), around, borderType=cv2.BORDER_CONSTANT))

    count = smooth(known_here.astype(np.float32))
    start = float(np.median(square[known_here])) / 0.455 if known_here.any() else 1.0
    # Neighbourhoods with few pixels are like the map.
    least = 0.5 * _SAMPLES**2
    variance = np.full((rows, columns), start + 1e-12)
    for _ in range(_ROUNDS):
        bounded = np.minimum(square, _BOUND * enlarged(variance, square.shape, _SAMPLES))
        sums = smooth(np.where(known_here, bounded, 0)) / _BOUNDED_MEAN
        variance = (sums + least * start) / (count + least)
    return np.asarray(np.sqrt(enlarged(variance, z.shape, side)), np.float32)


def threshold(area_px: float, false_alarm: float, *, albedo: bool) -> float:
    """Return the |z| that noise exceeds anywhere in a map with at most a given probability.

    The expected Euler characteristic of the places above a level (Worsley, Estimating the number
    of peaks in a random field using the Hadwiger characteristic of excursion sets, 1995) bounds the
    probability for one template; the sum over templates and signs bounds that of the map.
    """
    cells = [area_px / scale**2 for scale in SCALES_PX] * (2 if albedo else 1)
    cells += [area_px / (scale * _LINE_PX) for scale in LINES_PX] * _DIRECTIONS

    def expected(level: float) -> float:
        density = level * (2 * math.pi) ** -1.5 * math.exp(-(level**2) / 2)
        above = math.erfc(level / math.sqrt(2)) / 2
        return float(2 * sum(of * density + above for of in cells))

    return float(brentq(lambda level: expected(level) - false_alarm, 2.0, 20.0))
