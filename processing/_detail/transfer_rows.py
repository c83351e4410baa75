"""The steps of a transfer of detail, for any rows of its maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import DataError, MapRows
from processing._detail.placement import Placement
from processing._detail.rotation import rotate_between, rotate_from_z
from processing._normal_map import NormalMap, directions
from rig import in_threads

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class PlacedDetail:
    """The detail of a source as it is placed on a target, whose rows are computed on request.

    Parameters
    ----------
    normals, mask
        ``(h, w, 3)`` and ``(h, w)``: the detail of the source.
    room
        ``(H, W)`` bool, the mask of the target.
    placement
        Position of the source on the target.
    amplitude
        Factor on the slopes of the detail.
    """

    normals: MapRows
    mask: Mask
    room: Mask
    placement: Placement
    amplitude: float

    def rows(self, rows: slice) -> tuple[Float, Mask]:
        """Return the normals of some rows, and which pixels of the target receive detail."""
        placed = self.placement.place_rows(self.normals, self.mask, self.room, rows)
        return scaled_slopes(*placed, self.amplitude)


def scaled_slopes(normals: Float, mask: Mask, amplitude: float) -> tuple[Float, Mask]:
    """Return rows of a detail with its slopes multiplied by a factor, and where they are known."""
    if amplitude == 1:
        return normals, mask
    scaled = normals * np.array([amplitude, amplitude, 1.0], np.float32)
    # At amplitude 0 a horizontal normal becomes a zero vector; replace it by z, no detail.
    scaled[mask & ~scaled.any(axis=2)] = (0, 0, 1)
    found, known = np.zeros(normals.shape, np.float32), np.zeros(mask.shape, np.bool_)
    in_threads(directions, len(mask), scaled, mask, found, known)
    return found, known


def scale_slopes(detail: NormalMap, amplitude: float) -> NormalMap:
    """Return a detail with its slopes multiplied by a factor.

    Raises
    ------
    DataError
        If the amplitude is not finite.
    """
    check_amplitude(amplitude)
    if amplitude == 1:
        return detail
    return NormalMap(*scaled_slopes(detail.normals, detail.mask, amplitude))


def check_amplitude(amplitude: float) -> None:
    """Raise `DataError` if a factor on slopes is not finite."""
    if not np.isfinite(amplitude):
        raise DataError(
            f"a detail amplitude of {amplitude} is not a finite number: use 1 to keep the detail"
        )


def check_steps(refine: int) -> None:
    """Raise `DataError` if a number of refinement steps is negative."""
    if refine < 0:
        raise DataError(f"the number of refinement steps cannot be negative: {refine}")


def transferred(detail: Float, received: Mask, ground: Float, target: Float) -> Float:
    """Return rows of a target that received detail.

    Parameters
    ----------
    detail, received
        Detail in the local frames of the ground, and where there is some.
    ground
        The shape of the target, or its normals.
    target
        The normals of the target, which others keep.
    """
    return np.where(received[..., None], rotate_from_z(detail, ground), target)


def refined(normals: Float, received: Mask, has: Float, wanted: Float) -> Float:
    """Return rows of a result, rotated from the shape that it has to the one that is wanted."""
    return np.where(received[..., None], rotate_between(normals, has, wanted), normals)
