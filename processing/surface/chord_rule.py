"""Height steps along pixel edges from normals, by the chord rule.

The chord between two neighbouring surface points is assumed to be at right angles to the sum of
their normals: (n_i + n_j) . (P_j - P_i) = 0. This is exact on planes and on spheres. If c is the
cosine of the angle between the mean normal and the line of sight, an error e of the normal changes
the step by up to e / c^2. The weight of an edge is the inverse of that variance, c^4, so steep
edges, which include most occlusions, have little weight.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from acquisition import CameraModel
from processing.surface.extrapolation import extrapolate
from rig.arrays import Bool, Float32, Float64

# Edges below this cosine (within 0.6 degree of grazing), or seen from behind, are dropped.
_GRAZING = 1e-2
# Squared length of the sum of two normals that are 120 degrees apart; no edge connects pixels whose
# normals differ more.
_OPPOSED = 1.0


@numba.njit(cache=True)
def orthographic_edges(normals: Float32, mask: Bool) -> tuple[Float32, Float32, Float64, Float64]:
    """Return the edges between pixels of a mask and their height steps in pixels.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors.
    mask
        ``(H, W)`` bool.

    Returns
    -------
    right, down
        ``(H+2, W+2)`` float32 edge weights 0..1 (see `processing.surface.grid_graph`).
    step_right, step_down
        ``(H+2, W+2)`` float64 height of the right (lower) pixel above this one.
    """
    rows, columns = mask.shape
    right = np.zeros((rows + 2, columns + 2), np.float32)
    down = np.zeros((rows + 2, columns + 2), np.float32)
    step_right = np.zeros((rows + 2, columns + 2), np.float64)
    step_down = np.zeros((rows + 2, columns + 2), np.float64)
    for r in range(rows):
        for c in range(columns):
            if not mask[r, c]:
                continue
            for vertical in range(2):
                q, d = r + vertical, c + 1 - vertical
                if q >= rows or d >= columns or not mask[q, d]:
                    continue
                x = float(normals[r, c, 0]) + float(normals[q, d, 0])
                y = float(normals[r, c, 1]) + float(normals[q, d, 1])
                z = float(normals[r, c, 2]) + float(normals[q, d, 2])
                length2 = x * x + y * y + z * z
                cosine2 = z * z / length2 if length2 > _OPPOSED else 0.0
                if z <= 0 or cosine2 <= _GRAZING * _GRAZING:
                    continue
                if vertical:
                    down[r + 1, c + 1] = cosine2 * cosine2
                    step_down[r + 1, c + 1] = y / z
                else:
                    right[r + 1, c + 1] = cosine2 * cosine2
                    step_right[r + 1, c + 1] = -x / z
    return right, down, step_right, step_down


@numba.njit(cache=True)
def perspective_edges(
    normals: Float32, mask: Bool, rays: Float64
) -> tuple[Float32, Float32, Float64, Float64]:
    """Return the edges between pixels of a mask and their steps in logarithmic depth.

    With P = C + d r the chord rule is d_j / d_i = (m . r_i) / (m . r_j) with m = n_i + n_j.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors.
    mask
        ``(H, W)`` bool.
    rays
        ``(H, W, 3)`` float64 directions of the pixels from the camera, with z = -1.

    Returns
    -------
    right, down
        ``(H+2, W+2)`` float32 edge weights 0..1 (see `processing.surface.grid_graph`).
    step_right, step_down
        ``(H+2, W+2)`` float64 logarithm of the ratio of the right (lower) pixel's depth to this
        pixel's depth.
    """
    rows, columns = mask.shape
    right = np.zeros((rows + 2, columns + 2), np.float32)
    down = np.zeros((rows + 2, columns + 2), np.float32)
    step_right = np.zeros((rows + 2, columns + 2), np.float64)
    step_down = np.zeros((rows + 2, columns + 2), np.float64)
    for r in range(rows):
        for c in range(columns):
            if not mask[r, c]:
                continue
            for vertical in range(2):
                q, d = r + vertical, c + 1 - vertical
                if q >= rows or d >= columns or not mask[q, d]:
                    continue
                near, far = 0.0, 0.0
                length2, sight2 = 0.0, 0.0
                for k in range(3):
                    m = float(normals[r, c, k]) + float(normals[q, d, k])
                    near -= m * rays[r, c, k]
                    far -= m * rays[q, d, k]
                    length2 += m * m
                    sight2 += rays[r, c, k] * rays[r, c, k]
                cosine2 = near * far / (length2 * sight2) if length2 > _OPPOSED else 0.0
                if min(near, far) <= 0 or cosine2 <= _GRAZING * _GRAZING:
                    continue
                if vertical:
                    down[r + 1, c + 1] = cosine2 * cosine2
                    step_down[r + 1, c + 1] = math.log(near / far)
                else:
                    right[r + 1, c + 1] = cosine2 * cosine2
                    step_right[r + 1, c + 1] = math.log(near / far)
    return right, down, step_right, step_down


def facing_cosines(normals: Float32, rays: Float64) -> Float32:
    """Return the ``(H, W)`` float32 dot product of each normal and the line of sight to the camera.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors.
    rays
        ``(H, W, 3)`` float64 directions of the pixels from the camera, with z = -1.
    """
    cosines: Float32 = -np.einsum("rck,rck->rc", normals, rays).astype(np.float32)
    return cosines


class ChordRule:
    """The chord rule in a window of an image, with or without a camera.

    Parameters
    ----------
    window
        Rows and columns of the image.
    camera
        A perspective camera; None for an orthographic view.
    smooth
        The surface is smooth: correct steps by the normals before and after each edge.
    cell
        Pixels of the image along the side of a pixel of the rule. The last ones may be incomplete.
    """

    def __init__(
        self,
        window: tuple[slice, slice],
        camera: CameraModel | None,
        *,
        smooth: bool = False,
        cell: int = 1,
    ) -> None:
        self._window, self._camera, self._smooth = window, camera, smooth
        self.cell = cell
        # Pixels for a step of 1.
        self.step_px = 1.0 if camera is None else camera.focal_px / cell
        # Directions of the pixels from the camera; None for an orthographic view.
        self.rays: Float64 | None = None
        if camera is not None:
            rows, columns = (slice(each.start, each.stop, cell) for each in window)
            y, x = np.mgrid[rows, columns]
            self.rays = camera.rays(np.stack([x, y], axis=-1) + (cell - 1) / 2)

    def edges(self, normals: Float32, mask: Bool) -> tuple[Float32, Float32, Float64, Float64]:
        """Return weights and steps of the edges to the right and down, in a border of one pixel."""
        if self.rays is None:
            right, down, *steps = orthographic_edges(normals, mask)
        else:
            right, down, *steps = perspective_edges(normals, mask, self.rays)
        if self._smooth:
            self.correct(normals, (right, down), (steps[0], steps[1]))
        return right, down, steps[0], steps[1]

    def correct(
        self, normals: Float32, edges: tuple[Float32, Float32], steps: tuple[Float64, Float64]
    ) -> None:
        """Correct steps in place where the surface is smooth: where it has the given edges."""
        extrapolate(normals, self.rays, edges, steps, self.step_px)

    def halved(self) -> ChordRule:
        """Return the rule for pixels of twice the size."""
        return ChordRule(self._window, self._camera, cell=2 * self.cell)

    @property
    def halving(self) -> float:
        """What a solution of the halved rule is multiplied by: heights are in its pixels."""
        return 2.0 if self.rays is None else 1.0

    def facing(self, normals: Float32, mask: Bool) -> Float32:
        """Return the cosines between normals and lines of sight in a border, 0 outside the mask."""
        cosines = normals[..., 2] if self.rays is None else facing_cosines(normals, self.rays)
        return np.pad(np.where(mask, cosines, np.float32(0)), 1)
