"""Heights of a result in the order of the heights of its target, as plotted in the paper."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from acquisition import DataError
from processing.surface.height_map import HeightMap
from rig import check_type, short_repr
from rig.arrays import Float32, Float64, Intp

_WINDOW_PX = 5


@dataclass(frozen=True, eq=False)
class HeightProfile:
    """Heights of the common pixels of two surfaces, in ascending order of the target's height.

    Parameters
    ----------
    target
        ``(N,)`` float32, heights of the target in `unit`, ascending.
    result
        ``(N,)`` float32, heights of the result at the same pixels.
    smoothed
        ``(N,)`` float32, heights of the result averaged over 5 x 5 pixels.
    unit
        ``mm`` or ``px``.
    difference
        ``(H, W)`` float32, result minus target in `unit`, NaN where either is not known. It shows
        to which region of the surface a branch of the profile belongs.
    """

    target: Float32
    result: Float32
    smoothed: Float32
    unit: str
    difference: Float32

    __repr__ = short_repr

    @property
    def rms(self) -> float:
        """Root mean square of the result minus the target."""
        return _rms(self.result, self.target)

    @property
    def smoothed_rms(self) -> float:
        """Root mean square of the smoothed result minus the target."""
        return _rms(self.smoothed, self.target)

    @property
    def target_range(self) -> float:
        """Difference between the highest and the lowest pixel of the target."""
        return float(np.ptp(self.target))

    def ranks(self, most: int = 4000) -> Intp:
        """Return evenly spaced indices into the profile, including both ends, to plot or list."""
        count = len(self.target)
        return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))


def height_profile(target: HeightMap, result: HeightMap) -> HeightProfile:
    """Compare the heights of a result with those of its target.

    The height offset of each connected part of a surface is arbitrary: the parts of the result are
    shifted to the mean height of the target at the same pixels.

    Parameters
    ----------
    target, result
        Surfaces of the same size and unit.

    Raises
    ------
    DataError
        If the sizes or units differ or the masks do not overlap.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, height_profile, integrate
    >>> y, x = np.mgrid[1:-1:16j, -1:1:16j]
    >>> bowl = integrate(NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2])))
    >>> deeper = integrate(NormalMap.from_vectors(np.dstack([1.1 * x, 1.1 * y, 0 * x + 2])))
    >>> round(height_profile(bowl, deeper).rms, 3)  # pixels
    0.089
    """
    check_type("target", target, HeightMap, "integrate(normal_map) returns one")
    check_type("result", result, HeightMap, "integrate(normal_map) returns one")
    if target.mask.shape != result.mask.shape or target.unit != result.unit:
        raise DataError("cannot compare two surfaces of different size or unit")
    both = target.mask & result.mask
    if not both.any():
        raise DataError("the surfaces of target and result do not overlap")
    # Align each pair of parts separately: one surface may be connected where the other is not.
    pair = target.parts[both].astype(np.int64) * (result.parts.max() + 1) + result.parts[both]
    _, part = np.unique(pair, return_inverse=True)
    off = result.height[both].astype(np.float64) - target.height[both]
    off_mean = np.bincount(part, off) / np.bincount(part)
    height = np.zeros(both.shape)
    height[both] = result.height[both] - off_mean[part]
    weight = _average(both.astype(np.float64))
    smoothed = _average(height)[both] / weight[both]
    order = np.argsort(target.height[both], kind="stable")
    difference = np.full(both.shape, np.nan, np.float32)
    difference[both] = height[both] - target.height[both]
    return HeightProfile(
        target=target.height[both][order],
        result=height[both][order].astype(np.float32),
        smoothed=smoothed[order].astype(np.float32),
        unit=target.unit,
        difference=difference,
    )


def _average(image: Float64) -> Float64:
    size = (_WINDOW_PX, _WINDOW_PX)
    return np.asarray(cv2.blur(image, size, borderType=cv2.BORDER_CONSTANT), np.float64)


def _rms(a: Float32, b: Float32) -> float:
    return float(np.sqrt(np.mean((a.astype(np.float64) - b) ** 2)))
