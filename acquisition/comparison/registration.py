"""Registration of two images that differ by a shift and a gain, with standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from acquisition.comparison.resampling import lanczos
from rig.arrays import Bool, Float32, Float64, UInt8

# Smoothing before slopes are taken, pixels: slopes of single pixels are mostly noise.
_SMOOTHING_PX: Final = 1.0
# Structure wider than this share of the image is removed: light that falls off over the image does
# not move with it.
_WIDEST: Final = 1 / 8
# The shift of the phase correlation must fit better than none by this factor: any shift fits where
# there is little structure.
_BETTER: Final = 0.9
# The refinement arrives at the same shift from a start so near to it.
_SAME_PX: Final = 0.5
_MOST_STEPS: Final = 20
_SETTLED_PX: Final = 1e-4
# Tukey's biweight, in standard deviations: efficiency 95 % for normal errors.
_TUKEY: Final = 4.685
# Least deviation relative to the structure.
_EXACT: Final = 1e-4
# Standard deviation of a shift by interpolation, pixels.
_INTERPOLATED_PX: Final = 0.01
# Classes of brightness whose residuals are compared: noise grows with the light.
_CLASSES: Final = 16
# Tiles along each axis whose scores give the covariance: errors within a tile may be correlated.
_TILES: Final = 8
# Structure counts as common if its energy exceeds this multiple of what independent noise causes:
# 4 standard deviations, with an area of correlated noise of 12 pixels after smoothing.
_SEEN: Final = 4 * 12**0.5
# Scores of shift and gain, with the signs of a descent.
_SCORES: Final = (("x", -1), ("y", -1), ("l", 1))


@dataclass(frozen=True, eq=False)
class Plane:
    """An image of one channel.

    Parameters
    ----------
    light
        ``(H, W)`` light above black.
    valid
        ``(H, W)`` pixels that are not saturated.
    """

    light: Float32
    valid: Bool

    def sampled(self, shift: Float64) -> Plane:
        """Return the image at positions moved by ``(right, down)``; outside it is not valid."""
        if not np.any(shift):
            return self
        whole = np.rint(shift).astype(int)
        right, down = (lanczos(float(part)) for part in shift - whole)
        light = cv2.sepFilter2D(self.light, cv2.CV_32F, right, down)
        valid = cv2.erode(self.valid.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
        columns, rows = whole.tolist()
        return Plane(
            np.roll(np.asarray(light, np.float32), (-rows, -columns), (0, 1)),
            _moved_in(np.asarray(valid), rows, columns),
        )


def _moved_in(valid: Bool, rows: int, columns: int) -> Bool:
    """Return the samples ``rows`` down and ``columns`` right of each; False outside."""
    moved = np.zeros_like(valid)
    height, width = valid.shape
    to = (
        slice(max(0, -rows), max(0, min(height, height - rows))),
        slice(max(0, -columns), max(0, min(width, width - columns))),
    )
    source = (
        slice(max(0, rows), max(0, min(height, height + rows))),
        slice(max(0, columns), max(0, min(width, width + columns))),
    )
    moved[to] = valid[source]
    return moved


@dataclass(frozen=True, eq=False)
class Registered:
    """Two images at the same positions.

    Parameters
    ----------
    shift
        ``(right, down)`` of the content from the first to the second image, pixels.
    covariance
        ``(2, 2)`` of the shift, square pixels; infinite if the images show no common structure in
        both directions.
    first, second
        Both images, each moved half way, so that interpolation blurs them alike.
    misfit
        Robust standard deviation of the difference after shift and gain.
    """

    shift: Float64
    covariance: Float64
    first: Plane
    second: Plane
    misfit: float

    @property
    def determined(self) -> bool:
        """Whether the images determine the shift."""
        return bool(np.isfinite(self.covariance).all())


def register(first: Plane, second: Plane) -> Registered:
    """Find shift and gain between two images of the same size.

    The shift is searched for by phase correlation (Kuglin and Hines 1975), then refined with the
    gain by iterated least squares on the slopes (Lucas and Kanade 1981), with Tukey's biweight, so
    that a part that moved by itself has no influence. Both images are moved half way, and the
    normal equations use the slopes that both have in common: noise then neither biases the shift
    nor counts as structure.

    Parameters
    ----------
    first, second
        Images of the same size.
    """
    gain = _level_ratio(first, second)
    one, two = _structure(first), _structure(second)
    classes = _classes(first.light)
    near = _refined(one, two, classes, gain, np.zeros(2))
    coarse = _coarse_shift(one, two)
    best = near
    if not near.determined or np.any(np.abs(coarse - near.shift) > _SAME_PX):
        far = _refined(one, two, classes, gain, coarse)
        best = far if far.misfit < _BETTER * near.misfit and far.determined else near
    halves = first.sampled(-best.shift / 2), second.sampled(best.shift / 2)
    return Registered(best.shift, best.covariance, *halves, best.misfit)


def _level_ratio(first: Plane, second: Plane) -> float:
    valid = first.valid & second.valid
    below = float(first.light[valid].sum(dtype=np.float64))
    return float(second.light[valid].sum(dtype=np.float64)) / below if below > 0 else 1.0


def _structure(plane: Plane) -> Plane:
    """Return an image without its noise and without what is wider than an eighth of it."""
    fine = cv2.GaussianBlur(plane.light, (0, 0), _SMOOTHING_PX)
    side = 2 * int(_WIDEST * min(plane.light.shape) / 2) + 1
    wide = cv2.blur(cv2.blur(fine, (side, side)), (side, side))
    # Saturated pixels spread into their neighbours.
    reach = np.ones((7, 7), np.uint8)
    valid = cv2.erode(plane.valid.astype(np.uint8), reach, borderValue=1) > 0
    return Plane(np.asarray(fine - wide, np.float32), np.asarray(valid))


def _coarse_shift(first: Plane, second: Plane) -> Float64:
    """Return the shift at the peak of the phase correlation."""
    window = cv2.createHanningWindow(first.light.shape[::-1], cv2.CV_32F)
    shift, _ = cv2.phaseCorrelate(first.light, second.light, window)
    return np.array(shift)


def _classes(light: Float32) -> UInt8:
    """Return the class of brightness of each pixel; the classes have equally many pixels."""
    smooth = cv2.GaussianBlur(light, (0, 0), 2 * _SMOOTHING_PX)
    limits = np.quantile(smooth, np.arange(1, _CLASSES) / _CLASSES).astype(np.float32)
    return np.asarray(np.searchsorted(limits, smooth), np.uint8)


def _refined(
    first: Plane, second: Plane, classes: UInt8, gain: float, start: Float64
) -> Registered:
    """Refine shift and gain from a start."""
    shift = np.array(start, np.float64)
    limit = np.array(first.light.shape[::-1]) / 2
    step = np.zeros(2)
    for number in range(_MOST_STEPS):
        one, two = first.sampled(-shift / 2), second.sampled(shift / 2)
        valid = one.valid & two.valid
        valid[[0, -1]] = valid[:, [0, -1]] = False
        if np.count_nonzero(valid) < 9 * _TILES:
            break
        equations = _Equations(one.light, two.light, valid, classes, gain)
        last = number == _MOST_STEPS - 1 or (number > 0 and float(np.hypot(*step)) < _SETTLED_PX)
        if last:
            return Registered(shift, equations.covariance(), one, two, equations.misfit)
        step, gain = equations.step()
        shift = shift + np.clip(step, -2, 2)
        if np.any(np.abs(shift) > limit):
            break
    return Registered(np.zeros(2), np.full((2, 2), np.inf), first, second, np.inf)


class _Equations:
    """Weighted normal equations of shift and gain at one shift."""

    def __init__(
        self, one: Float32, two: Float32, valid: Bool, classes: UInt8, gain: float
    ) -> None:
        left = two - np.float32(gain) * one
        # Exact images have no noise.
        least = _EXACT * float(np.sqrt(np.square(one[valid]).mean())) + 1e-9
        spread = np.maximum(_spread(left, valid, classes), least)
        self.misfit = float(np.square(spread).mean()) ** 0.5
        scale = spread.astype(np.float32)[classes]
        # Weighted by the variance, too, since bright pixels have more noise than dark ones.
        robust = np.square(np.maximum(1 - np.square(left / (_TUKEY * scale)), 0))
        weight = np.where(valid, robust / np.square(scale), 0)
        slopes = [(_slopes(one) * np.float32(gain)), _slopes(two)]
        mean = (slopes[0] + slopes[1]) / 2
        self._gain, self._slopes, self._weight = gain, slopes, weight
        # Slopes times slopes, slopes times light, light times light, and scores.
        self._terms = {
            "xx": slopes[0][0] * slopes[1][0],
            "xy": (slopes[0][0] * slopes[1][1] + slopes[0][1] * slopes[1][0]) / 2,
            "yy": slopes[0][1] * slopes[1][1],
            "xl": mean[0] * one,
            "yl": mean[1] * one,
            "ll": one * one,
            "x": mean[0] * left,
            "y": mean[1] * left,
            "l": one * left,
        }
        self._total = {
            name: float(np.sum(weight * term, dtype=np.float64))
            for name, term in self._terms.items()
        }

    def step(self) -> tuple[Float64, float]:
        """Return the change of the shift, and the new gain."""
        score = np.array([sign * self._total[name] for name, sign in _SCORES])
        if not self._seen():
            light = self._total["ll"]
            return np.zeros(2), self._gain + (float(score[2]) / light if light > 0 else 0.0)
        right, down, change = np.linalg.solve(self._matrix(), score)
        return np.array([right, down]), self._gain + float(change)

    def covariance(self) -> Float64:
        """Return the covariance of the shift from the scatter of the tiles' scores."""
        if not self._seen():
            return np.full((2, 2), np.inf)
        scores = np.stack(
            [sign * _tile_sums(self._weight * self._terms[name]).ravel() for name, sign in _SCORES]
        )
        inverse = np.linalg.inv(self._matrix())
        # The sandwich estimator: valid also where errors are correlated within a tile.
        by_scatter = (inverse @ (scores @ scores.T) @ inverse)[:2, :2]
        return np.asarray(by_scatter + _INTERPOLATED_PX**2 * np.eye(2))

    def _matrix(self) -> Float64:
        t = self._total
        return np.array(
            [
                [t["xx"], t["xy"], -t["xl"]],
                [t["xy"], t["yy"], -t["yl"]],
                [-t["xl"], -t["yl"], t["ll"]],
            ]
        )

    def _seen(self) -> bool:
        """Return whether both images have common slopes in both directions."""
        energy = self._matrix()[:2, :2]
        values, vectors = np.linalg.eigh(energy)
        along = vectors[:, 0].astype(np.float32)
        one, two = (np.tensordot(along, slopes, 1) for slopes in self._slopes)
        by_chance = float(np.linalg.norm(self._weight * one * two))
        return bool(values[0] > _SEEN * by_chance)


def _spread(left: Float32, valid: Bool, classes: UInt8) -> Float64:
    """Return the robust standard deviation of residuals for each class of brightness."""
    residuals, of = np.abs(left[valid]), classes[valid]
    spread = np.full(_CLASSES, np.nan)
    ends = np.cumsum(np.bincount(of, minlength=_CLASSES))
    groups = np.split(residuals[np.argsort(of, kind="stable")], ends[:-1])
    for number, own in enumerate(groups):
        if own.size:
            spread[number] = np.partition(own, own.size // 2)[own.size // 2]
    spread *= 1.4826
    return np.asarray(np.nan_to_num(spread, nan=float(np.nanmax(spread))))


def _slopes(light: Float32) -> Float32:
    """Return the slopes right and down, ``(2, H, W)``."""
    right = cv2.Sobel(light, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    down = cv2.Sobel(light, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    return np.stack([right, down]).astype(np.float32)


def _tile_sums(values: Float32) -> Float64:
    """Return the sums of a grid of tiles, ``(T, T)``."""
    edges = [np.linspace(0, length, _TILES + 1).astype(np.intp)[:-1] for length in values.shape]
    rows = np.add.reduceat(values, edges[0], axis=0, dtype=np.float64)
    return np.asarray(np.add.reduceat(rows, edges[1], axis=1))
