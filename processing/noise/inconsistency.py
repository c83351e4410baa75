"""Where normals contradict each other: errors of the model are there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import MapRows
from acquisition.files import rows_in_bands
from processing.noise.around import sum_around
from processing.noise.lens_blur import rows_that_show
from rig import short_repr
from rig.arrays import Bool, Float32

# Pixels across over which squared curls are averaged.
_ACROSS = 11
# Steeper slopes are those of this z.
_STEEPEST = 0.15
# Share of the errors of the model that goes with the curl, the rest is the same in all pixels: on
# simulated glossy objects and a real ball, this ranks errors best.
_SHARE = 0.7
# Bytes of rows that are computed at once, and of a pixel while it is computed.
_BAND, _PIXEL_BYTES = 32_000_000, 64


@dataclass(frozen=True)
class Inconsistency:
    """How far the normals of an object are from those of a surface.

    The slopes of a surface have no curl. Gloss, shadows and light from elsewhere turn normals in
    ways that no surface has, and residuals hardly show where.

    Parameters
    ----------
    mean
        Mean over the object of the root mean square curl around each pixel.
    """

    mean: float

    __repr__ = short_repr

    @classmethod
    def of(cls, normals: MapRows, valid: Bool) -> Inconsistency:
        """Return that of a map of normals ``(H, W, 3)``, of which some rows are read."""
        total, pixels = 0.0, 0
        for rows in rows_that_show(valid):
            inside = valid[rows]
            total += float(_curl_around(normals[rows], inside)[inside].sum(dtype=np.float64))
            pixels += int(np.count_nonzero(inside))
        return cls(total / max(pixels, 1))

    def factor(self, normals: MapRows, valid: Bool, rows: slice) -> Float32:
        """Return the factors of the variances of the model, 1 on average, of some rows.

        Parameters
        ----------
        normals
            ``(H, W, 3)`` unit normals.
        valid
            ``(H, W)`` bool, the pixels with a normal.
        rows
            Rows to compute, with start and stop.
        """
        found = np.ones((rows.stop - rows.start, valid.shape[1]), np.float32)
        around = _ACROSS // 2 + 1
        for band in rows_in_bands(len(found), _PIXEL_BYTES * valid.shape[1], _BAND):
            first, last = rows.start + band.start, rows.start + band.stop
            part = slice(max(first - around, 0), min(last + around, len(valid)))
            curl = _curl_around(normals[part], valid[part])[first - part.start :][: last - first]
            if self.mean > 0:
                found[band] = 1 - _SHARE + _SHARE * curl / np.float32(self.mean)
        return found


def _curl_around(normals: Float32, valid: Bool) -> Float32:
    """Return the root mean square curl of the squares of four pixels around each pixel."""
    z = np.maximum(normals[..., 2], np.float32(_STEEPEST))
    right, down = -normals[..., 0] / z, normals[..., 1] / z
    across, along = right[:, 1:] + right[:, :-1], down[1:] + down[:-1]
    curl = (across[:-1] + along[:, 1:] - across[1:] - along[:, :-1]) / 2
    square = np.zeros(valid.shape, np.float32)
    known = np.zeros(valid.shape, np.bool_)
    known[:-1, :-1] = valid[1:, 1:] & valid[1:, :-1] & valid[:-1, 1:] & valid[:-1, :-1]
    square[:-1, :-1] = np.where(known[:-1, :-1], np.square(curl), 0)
    count = sum_around(known.astype(np.float32), _ACROSS)
    mean = np.maximum(sum_around(square, _ACROSS), 0) / np.maximum(count, 1)
    return np.asarray(np.where(valid, np.sqrt(mean), 0), np.float32)
