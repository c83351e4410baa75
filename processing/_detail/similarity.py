"""Translation, scaling, rotation and mirroring of a normal map in the image plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numba
import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._normal_map import NormalMap
from rig import in_threads

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Double = npt.NDArray[np.float64]

_ON_PIXEL = 1e-9
_MOST_SCALE = 1000.0
_FARTHEST_PX = 1e6


@dataclass(frozen=True)
class Pose:
    """Position, size and orientation of a part of one surface on another.

    Parameters
    ----------
    at
        Column and row of the target at which the centre of the part's bounding box is placed; None
        for the default of the function that places it.
    scale, rotate_deg, mirror
        Factor on lengths, counter-clockwise rotation in degrees, and whether left and right are
        exchanged first; see `Similarity`, which also checks their ranges.
    """

    at: tuple[float, float] | None = None
    scale: float = 1.0
    rotate_deg: float = 0.0
    mirror: bool = False


@dataclass(frozen=True)
class Similarity:
    """The placement of one image on another.

    The image is mirrored, scaled and rotated about its anchor, which is then moved to `at`.

    Parameters
    ----------
    anchor, at
        (column, row) in the image, and its position in the other image.
    scale
        Factor on lengths, 0.001 to 1000. Heights are scaled like widths, so slopes do not change.
    rotate_deg
        Counter-clockwise rotation in the image.
    mirror
        Exchange left and right first.

    Raises
    ------
    DataError
        If a number is not finite or out of range.
    """

    anchor: tuple[float, float]
    at: tuple[float, float]
    scale: float = 1.0
    rotate_deg: float = 0.0
    mirror: bool = False

    def __post_init__(self) -> None:
        if not 1 / _MOST_SCALE <= self.scale <= _MOST_SCALE:
            raise DataError(
                f"a scale of {self.scale} is not possible: give a number from {1 / _MOST_SCALE:g} "
                f"to {_MOST_SCALE:g}"
            )
        if not all(abs(value) <= _FARTHEST_PX for value in (*self.anchor, *self.at)):
            raise DataError(
                f"a place of {self.at} is not possible: give numbers up to {_FARTHEST_PX:g}"
            )
        if not math.isfinite(self.rotate_deg):
            raise DataError(f"a turn of {self.rotate_deg} degree is not possible")

    @property
    def _turn(self) -> Double:
        """The 2 x 2 rotation and mirroring, x right and y up."""
        angle = math.radians(self.rotate_deg)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        return turn * [-1.0 if self.mirror else 1.0, 1.0]

    @property
    def _back(self) -> Double:
        """The 2 x 3 matrix from (column, row, 1) of the frame to (column, row) of the image."""
        # Rows count downwards: in pixels, the rotation of vectors is conjugated by the flip of y.
        flip = np.array([1.0, -1.0])
        back = np.linalg.inv(self.scale * (flip[:, None] * self._turn * flip))
        return np.column_stack([back, np.array(self.anchor) - back @ np.array(self.at)])

    def place(self, normal_map: NormalMap, size: tuple[int, int]) -> NormalMap | None:
        """Return the map placed on a frame of (height, width) pixels, with rotated normals.

        The interpolation is Catmull-Rom, after a low-pass filter if the scale is below 1. A shift
        by whole pixels changes no normal. Pixels whose support is not completely inside the mask
        are left out. If no pixel is left on the frame, the method returns None.
        """
        vectors = normal_map.normals
        if self.scale < 1:
            sigma_px = 0.5 * math.sqrt(1 / self.scale**2 - 1)
            weight = cv2.GaussianBlur(normal_map.mask.astype(np.float32), (0, 0), sigma_px)
            blurred = cv2.GaussianBlur(vectors, (0, 0), sigma_px)
            vectors = np.asarray(blurred / np.maximum(weight, 1e-6)[..., None], np.float32)
        placed, known = np.zeros((*size, 3), np.float32), np.zeros(size, np.bool_)
        in_threads(_sample, size[0], vectors, normal_map.mask, self._back, placed, known)
        if not known.any():
            return None
        placed[..., :2] = placed[..., :2] @ self._turn.T.astype(np.float32)
        return NormalMap.from_vectors(placed, known)

    def place_mask(self, mask: Mask, size: tuple[int, int]) -> Mask:
        """Return a mask placed on a frame of (height, width) pixels."""
        rows, columns = np.indices(size)
        back = self._back
        x, y = (
            np.rint(back[k, 0] * columns + back[k, 1] * rows + back[k, 2]).astype(np.intp)
            for k in (0, 1)
        )
        on = (x >= 0) & (x < mask.shape[1]) & (y >= 0) & (y < mask.shape[0])
        placed = np.zeros(size, np.bool_)
        placed[on] = mask[y[on], x[on]]
        return placed


@numba.njit(cache=True)
def _weights(fraction: float, out: Double) -> None:
    """Write the weights of the pixels at -1, 0, 1 and 2; exact for quadratic functions."""
    f = fraction
    out[0] = f * (-0.5 + f * (1 - 0.5 * f))
    out[1] = 1 + f * f * (-2.5 + 1.5 * f)
    out[2] = f * (0.5 + f * (2 - 1.5 * f))
    out[3] = f * f * (-0.5 + 0.5 * f)


@numba.njit(cache=True)
def _split(position: float) -> tuple[int, float]:
    """Return the integer and fractional part; remove rounding errors close to a pixel."""
    nearest = round(position)
    if abs(position - nearest) < _ON_PIXEL:
        return int(nearest), 0.0
    whole = math.floor(position)
    return int(whole), position - whole


@numba.njit(nogil=True, cache=True)
def _sample(
    first: int, last: int, vectors: Float, mask: Mask, back: Double, out: Float, known: Mask
) -> None:
    rows, columns = mask.shape
    across, down = np.zeros(4), np.zeros(4)
    for r in range(first, last):
        for c in range(known.shape[1]):
            left, part = _split(back[0, 0] * c + back[0, 1] * r + back[0, 2])
            _weights(part, across)
            top, part = _split(back[1, 0] * c + back[1, 1] * r + back[1, 2])
            _weights(part, down)
            whole = True
            x, y, z = 0.0, 0.0, 0.0
            for j in range(4):
                for i in range(4):
                    weight = down[j] * across[i]
                    if weight == 0:
                        continue
                    q, d = top - 1 + j, left - 1 + i
                    if q < 0 or q >= rows or d < 0 or d >= columns or not mask[q, d]:
                        whole = False
                        break
                    x += weight * vectors[q, d, 0]
                    y += weight * vectors[q, d, 1]
                    z += weight * vectors[q, d, 2]
                if not whole:
                    break
            if whole:
                known[r, c] = True
                out[r, c, 0], out[r, c, 1], out[r, c, 2] = x, y, z
