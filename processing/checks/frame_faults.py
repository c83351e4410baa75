"""Faults of single frames: rows that do not belong to it, and shifts against the other images."""

from __future__ import annotations

import cv2
import numpy as np

from acquisition import Lights
from processing.checks.self_calibration import robust_solution
from processing.images.block_means import Cells
from processing.stereo.normals_and_albedo import photometric_stereo
from rig.arrays import Bool, Float64, Intp

# Cells darker than this share of their albedo may be in shadow.
_LIT = 0.2
# Rows that do not belong to an image deviate by this share of the albedo, and by this multiple of
# what the same rows do in the other images. They are at most this share of all rows.
_FOREIGN = 0.2
_FOREIGN_FACTOR = 4.0
_MOST_ROWS = 0.6
_FEWEST_CELLS = 8
# This share of the cells of a foreign row may agree. Rows next to it agree: shadows begin
# gradually.
_AGREE = 0.35
_QUIET = 0.5
# Rows with fewer cells than this share of the widest row are not judged.
_WIDTH = 0.25
_SOLID = 0.8
# Least shares of the rows, inside the object and at its ends.
_THICK = 0.02
_AT_END = 0.1
# A shift is at least this large, in cells and relative to the typical one, explains this much, and
# the image deviates by this multiple of what is typical: gloss and shadows deviate less. A smaller
# part of the object does not distinguish them.
_SHIFT = 0.5
_SHIFT_FACTOR = 6.0
_EXPLAINED = 0.9
_SHIFT_DEVIATION = 5.0
_FEWEST_INSIDE = 400
_STEPS = 5


class PredictedCells:
    """The images of all cells, and what normals from all of them predict.

    Parameters
    ----------
    cells
        N images.
    lights
        Their lights.
    strengths
        ``(N,)`` brightness of the images relative to the lights.

    Raises
    ------
    EstimateError
        If the images have no normals.
    """

    def __init__(self, cells: Cells, lights: Lights, strengths: Float64) -> None:
        self._cells = cells
        values = cells.values / strengths[:, None, None].astype(np.float32)
        solved = photometric_stereo(
            values, lights, cells.mask, method="cauchy", points_mm=cells.points_mm
        )
        normals, albedo = solved.normal_map.normals, solved.albedo
        if lights.near and cells.points_mm is not None:
            vectors = lights.vectors_at(cells.points_mm)
            cosine = np.sum(vectors * normals, axis=3)
        else:
            cosine = np.tensordot(lights.unit_directions, normals, (1, 2))
        self._predicted = np.maximum(albedo * cosine, 0)
        with np.errstate(invalid="ignore"):
            self._lit = np.isfinite(values) & (self._predicted > _LIT * albedo) & (albedo > 0)
        scale = np.where(albedo > 0, albedo, 1)
        self._left = np.where(self._lit, (values - self._predicted) / scale, 0.0)
        self._predicted = self._predicted / scale

    def stripes(self) -> list[tuple[int, int] | None]:
        """Return for each image the first and the last row in pixels that do not belong to it."""
        off = np.sort(np.where(self._lit, np.abs(self._left), np.inf), axis=2)
        count = self._lit.sum(axis=2)
        # Most cells of a foreign row deviate by more.
        place = np.floor(_AGREE * count).astype(np.intp)[..., None]
        profile = np.take_along_axis(off, place, axis=2)[..., 0]
        wide = count >= max(_FEWEST_CELLS, _WIDTH * int(count.max()))
        typical = np.median(np.where(wide, profile, 0), axis=0)
        foreign = wide & (profile > np.maximum(_FOREIGN, _FOREIGN_FACTOR * typical))
        quiet = wide & (profile < _QUIET * _FOREIGN)
        size, top = self._cells.size, self._cells.corner[0]
        found: list[tuple[int, int] | None] = []
        for i in range(len(foreign)):
            block = _block(foreign[i], quiet[i], np.flatnonzero(wide[i]))
            if block is None:
                found.append(None)
                continue
            found.append((top + block[0] * size, top + (block[1] + 1) * size - 1))
        return found

    def shifts_px(self) -> Float64:
        """Return ``(N, 2)`` shifts right and down in pixels, 0 if an image fits."""
        count = len(self._left)
        shifts, before, after = np.zeros((count, 2)), np.zeros(count), np.zeros(count)
        for i in range(count):
            shifts[i], before[i], after[i] = self._shift(i)
        size = np.hypot(*shifts.T)
        large = size > max(_SHIFT, _SHIFT_FACTOR * float(np.median(size)))
        deviates = before > _SHIFT_DEVIATION * float(np.median(before))
        found = large & deviates & (after < _EXPLAINED * before)
        return np.where(found[:, None], shifts * self._cells.size, 0.0)

    def _shift(self, i: int) -> tuple[Float64, float, float]:
        """Return the shift in cells along the slopes of the prediction.

        Then come the median absolute deviations before and after.
        """
        inside = cv2.erode(self._lit[i].view(np.uint8), np.ones((3, 3), np.uint8)) > 0
        if np.count_nonzero(inside) < _FEWEST_INSIDE:
            return np.zeros(2), 0.0, 0.0
        down, right = np.gradient(self._predicted[i])
        slopes = -np.stack([right[inside], down[inside]], axis=1)
        left = self._left[i][inside]
        shift, *_ = robust_solution(slopes, left, _STEPS, 2)
        before, after = (float(np.median(np.abs(x))) for x in (left, left - slopes @ shift))
        return shift, before, after


def _block(foreign: Bool, quiet: Bool, rows: Intp) -> tuple[int, int] | None:
    """Return the first and the last row of one block of foreign rows with sharp ends."""
    inside = np.flatnonzero(foreign)
    if not 0 < len(inside) <= _MOST_ROWS * len(rows):
        return None
    first, last = int(inside[0]), int(inside[-1])
    if len(inside) < _SOLID * (last - first + 1):
        return None
    # One row on either side may be foreign in part.
    above = rows[rows < first - 1]
    below = rows[rows > last + 1]
    # A shadow at the end of the object looks alike.
    if last - first + 1 < (_THICK if len(above) and len(below) else _AT_END) * len(rows):
        return None
    ends = [bool(quiet[side[at]]) for side, at in ((above, -1), (below, 0)) if len(side)]
    return (first, last) if ends and all(ends) else None
