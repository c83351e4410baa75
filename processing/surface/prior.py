"""Heights that are known from elsewhere: points, a coarse map, a rim."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from rig import short_repr
from rig.arrays import Bool, Float32, Float64


@dataclass(frozen=True, eq=False)
class HeightPrior:
    """Known heights with standard deviations at some pixels of a normal map.

    Parameters
    ----------
    height
        ``(H, W)`` float32 along +Z toward the camera, in the unit of the surface: mm, or pixels if
        its scale is not known. With a camera, heights are above the working plane. NaN where the
        height is not known.
    sigma
        ``(H, W)`` float32 standard deviation of each height, in the same unit. Errors of different
        pixels are independent. NaN where the height is not known.
    outside
        Number of heights that were given outside the image.

    Raises
    ------
    DataError
        If the shapes differ, no height is known, or a known height has no positive deviation.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import HeightPrior
    >>> points = HeightPrior.from_points([[2, 1], [5, 3]], [0.4, 0.7], 0.01, (4, 6))
    >>> points.count, float(points.height[3, 5])
    (2, 0.699999988079071)
    """

    height: Float32
    sigma: Float32
    outside: int = 0

    def __post_init__(self) -> None:
        known = self.known
        if self.height.ndim != 2 or np.shape(self.sigma) != self.height.shape:
            raise DataError(
                f"heights of shape {self.height.shape} and deviations of shape "
                f"{np.shape(self.sigma)} do not fit"
            )
        if not known.any():
            raise DataError("the prior contains no height")
        if not (np.isfinite(self.sigma[known]) & (self.sigma[known] > 0)).all():
            raise DataError("a height of the prior has no positive standard deviation")

    __repr__ = short_repr

    @property
    def known(self) -> Bool:
        """``(H, W)`` bool, pixels with a known height."""
        return np.isfinite(self.height)

    @property
    def count(self) -> int:
        """Number of pixels with a known height."""
        return int(np.count_nonzero(self.known))

    @classmethod
    def from_points(
        cls,
        positions_px: npt.ArrayLike,
        heights: npt.ArrayLike,
        sigma: npt.ArrayLike,
        size: tuple[int, int],
    ) -> HeightPrior:
        """Return the prior of points; each belongs to the pixel nearest to it.

        Parameters
        ----------
        positions_px
            ``(N, 2)`` column and row; whole numbers are the centres of pixels.
        heights, sigma
            ``(N,)`` heights and their standard deviations, or one deviation for all.
        size
            Height and width of the normal map in pixels.

        Raises
        ------
        DataError
            If a value is not finite, or no point is inside the image.
        """
        places = np.asarray(positions_px, np.float64).reshape(-1, 2)
        values = np.asarray(heights, np.float64).ravel()
        sigmas = np.broadcast_to(np.asarray(sigma, np.float64), values.shape)
        if len(places) != len(values) or not (
            np.isfinite(places).all() and np.isfinite(values).all() and (sigmas > 0).all()
        ):
            raise DataError("positions, heights or deviations of the prior are not valid numbers")
        column, row = np.floor(places + 0.5).T
        inside = (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
        if not inside.any():
            raise DataError(
                f"none of {len(values)} points of the prior is inside the image of {size[1]} x "
                f"{size[0]} pixels: positions are column and row"
            )
        index = (row[inside] * size[1] + column[inside]).astype(np.int64)
        # Points in the same pixel: their mean, weighted by the reciprocal variances.
        weights = np.bincount(index, sigmas[inside] ** -2, minlength=size[0] * size[1])
        sums = np.bincount(index, values[inside] / sigmas[inside] ** 2, len(weights))
        with np.errstate(invalid="ignore", divide="ignore"):
            height, spread = sums / weights, weights**-0.5
        spread[weights == 0] = np.nan
        return cls(
            height.reshape(size).astype(np.float32),
            spread.reshape(size).astype(np.float32),
            outside=int(np.count_nonzero(~inside)),
        )

    @classmethod
    def from_map(cls, heights: npt.ArrayLike, sigma: float, size: tuple[int, int]) -> HeightPrior:
        """Return the prior of a map of heights that shows the same area as the normal map.

        Between the centres of its pixels, the map is interpolated linearly. Each of its pixels is
        one measurement: if it covers n pixels of the normal map, each of them has n times its
        variance.

        Parameters
        ----------
        heights
            ``(h, w)`` heights, NaN where they are not known; the size of the normal map or smaller.
        sigma
            Standard deviation of each pixel of the map.
        size
            Height and width of the normal map in pixels.

        Raises
        ------
        DataError
            If the map is larger than the normal map, its pixels would not be square, or it contains
            no height.
        """
        with np.errstate(over="ignore"):
            values = np.asarray(heights, np.float32)
        if values.ndim != 2:
            raise DataError(f"a map of heights has one channel, this has shape {values.shape}")
        rows, columns = values.shape
        down, right = size[0] / rows, size[1] / columns
        # A coarse map of a side that is no multiple leaves out, or adds, part of a coarse pixel.
        fits = abs(size[0] - rows * right) < right or abs(size[1] - columns * down) < down
        if min(down, right) < 1 or not fits:
            raise DataError(
                f"a prior of {columns} x {rows} pixels does not show the same area as normals of "
                f"{size[1]} x {size[0]}: give a map of the same size, or a coarser one of the same "
                "shape"
            )
        values = np.where(np.isfinite(values), values, np.float32(np.nan))
        if (rows, columns) != size:
            y = (np.arange(size[0]) + 0.5) / down - 0.5
            x = (np.arange(size[1]) + 0.5) / right - 0.5
            values = _interpolated(values, y, x)
        spread = np.where(np.isfinite(values), sigma * np.sqrt(down * right), np.nan)
        return cls(values, spread.astype(np.float32))


def _interpolated(values: Float32, y: Float64, x: Float64) -> Float32:
    """Interpolate between the centres of pixels; NaN next to an unknown one and outside."""
    # Imported here: it takes 0.2 s, and few surfaces have a prior.
    from scipy.ndimage import map_coordinates

    places = np.meshgrid(y, x, indexing="ij")
    known = np.isfinite(values)
    found, share = (
        map_coordinates(image, places, order=1, mode="nearest")
        for image in (np.where(known, values, 0).astype(np.float32), known.astype(np.float32))
    )
    rows, columns = values.shape
    beyond = ((y < 0) | (y > rows - 1))[:, None] | ((x < 0) | (x > columns - 1))[None]
    found[beyond | (share < 1 - 1e-6)] = np.nan
    return np.asarray(found, np.float32)
