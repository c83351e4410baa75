"""Where errors of the model are: where normals contradict each other, and where they vary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from acquisition import MapRows
from acquisition.files import rows_in_bands
from processing.noise.around import mean_around, sum_around
from processing.noise.lens_blur import rows_that_show
from rig import short_repr
from rig.arrays import AnyArray, Bool, Float32

# Pixels across over which squares are averaged, and in which normals scatter.
_ACROSS, _DETAIL = 11, 5
# Steeper slopes are those of this z.
_STEEPEST = 0.15
# Share of what residuals state of a pixel that is averaged over the object: they hardly show where
# the errors are.
POOLED = 0.7
# Bytes of rows that are computed at once, and of a pixel while it is computed.
_BAND, _PIXEL_BYTES = 32_000_000, 64


@dataclass(frozen=True)
class Inconsistency:
    """How far the normals of an object are from those of a smooth surface.

    The slopes of a surface have no curl. Gloss, shadows and light from elsewhere turn normals in
    ways that no surface has, most of all in hollows and at edges, where normals vary.

    Parameters
    ----------
    curl, scatter
        Means over the object of the root mean square curl, and scatter of the normals, around each
        pixel.
    """

    curl: float
    scatter: float

    __repr__ = short_repr

    @classmethod
    def of(cls, normals: MapRows, valid: Bool) -> Inconsistency:
        """Return that of a map of normals ``(H, W, 3)``, of which some rows are read."""
        both = mean_of(lambda rows: np.stack(_around(normals[rows], valid[rows]), axis=-1), valid)
        return cls(float(both[0]), float(both[1]))

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
        around = _ACROSS // 2 + _DETAIL // 2
        for band in rows_in_bands(len(found), _PIXEL_BYTES * valid.shape[1], _BAND):
            first, last = rows.start + band.start, rows.start + band.stop
            part = slice(max(first - around, 0), min(last + around, len(valid)))
            both = zip(_around(normals[part], valid[part]), (self.curl, self.scatter), strict=True)
            known = [
                each[first - part.start :][: last - first] / mean for each, mean in both if mean > 0
            ]
            if known:
                found[band] = np.mean(known, axis=0)
        return found


def mean_of(values: Callable[[slice], Float32], valid: Bool) -> Float32:
    """Return the mean of values over the pixels ``valid`` of some rows.

    Parameters
    ----------
    values
        Returns values ``(R, W)`` or ``(R, W, C)`` of rows.
    valid
        ``(H, W)`` bool.
    """
    total: AnyArray = np.zeros(1)
    pixels = 0
    for rows in rows_that_show(valid):
        total = total + values(rows)[valid[rows]].sum(axis=0, dtype=np.float64)
        pixels += int(np.count_nonzero(valid[rows]))
    return np.asarray(total / max(pixels, 1), np.float32)


def _around(normals: Float32, valid: Bool) -> tuple[Float32, Float32]:
    """Return the root mean square curl and scatter of the normals around each pixel."""
    unit = np.where(valid[..., None], normals, 0)
    mean = np.stack([mean_around(each, valid, _DETAIL) for each in np.moveaxis(unit, 2, 0)], axis=2)
    scatter = np.maximum(1 - np.linalg.norm(mean, axis=2), 0)
    around = mean_around(np.where(valid, scatter, 0), valid, _ACROSS)
    return _curl_around(normals, valid), np.sqrt(np.maximum(around, 0))


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
