"""The exemplar of a synthesis: copies of a detail, and the places at which a patch fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._normal_map import NormalMap

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# A smaller mean angle is noise of files: nothing that could be continued.
_FLAT_DEG = 0.01


@dataclass(frozen=True, eq=False)
class Exemplar:
    """A detail, its turned and mirrored copies, and the places at which a patch fits.

    Parameters
    ----------
    vectors
        ``(copies, h, w, 3)`` float32; copies that are narrower or lower are padded with 0.
    slopes
        ``(copies, h, 2 w)``: n_x and n_y of the same.
    cells
        ``(copies, h, w)`` int32: number of the cell of the exemplar around the middle of the
        patch that starts here, -1 if a patch does not fit into the mask.
    starts
        Flat indices of the places where a patch fits.
    shares
        Share of the places that each cell has.
    mean_energy
        Mean of n_x^2 + n_y^2 over the mask.
    """

    vectors: Float
    slopes: Float
    cells: npt.NDArray[np.int32]
    starts: npt.NDArray[np.int32]
    shares: npt.NDArray[np.float64]
    mean_energy: float


def prepare_exemplar(detail: NormalMap, patch: int, *, rotate: bool, mirror: bool) -> Exemplar:
    """Prepare a detail for a size of patches.

    Raises
    ------
    DataError
        If the detail is flat, or no patch fits into its mask.
    """
    height, width = detail.size
    if min(height, width) < patch:
        raise DataError(
            f"the exemplar has {width} x {height} pixels, less than a patch of {patch} x {patch}: "
            "use a larger exemplar or smaller patches"
        )
    known = detail.normals[detail.mask]
    steep = np.hypot(known[:, 0], known[:, 1])
    angle = float(np.degrees(np.mean(np.arctan2(steep, known[:, 2]), dtype=np.float64)))
    if angle < _FLAT_DEG:
        raise DataError(
            f"the exemplar is flat: its mean detail angle is {angle:.2g} degrees, so it has no "
            "texture that could be continued"
        )
    cell = _cells(detail.mask, patch)
    if cell.max() < 0:
        raise DataError(
            f"no patch of {patch} x {patch} pixels fits into the mask of the exemplar: use an "
            "exemplar without holes or smaller patches"
        )
    copies = [
        _turned(detail.normals, cell, quarter, flip, patch)
        for quarter in range(4 if rotate else 1)
        for flip in ((False, True) if mirror else (False,))
    ]
    side = (max(height, width), max(height, width)) if rotate else (height, width)
    vectors = np.zeros((len(copies), *side, 3), np.float32)
    cells = np.full((len(copies), *side), -1, np.int32)
    for i, (normals, numbers) in enumerate(copies):
        vectors[i, : normals.shape[0], : normals.shape[1]] = normals
        cells[i, : normals.shape[0], : normals.shape[1]] = numbers
    starts = np.flatnonzero(cells >= 0).astype(np.int32)
    counts = np.bincount(cells.reshape(-1)[starts])
    slopes = np.ascontiguousarray(vectors[..., :2]).reshape(*cells.shape[:2], -1)
    energy = float(np.mean(steep**2, dtype=np.float64))
    return Exemplar(vectors, slopes, cells, starts, counts / len(starts), energy)


def _cells(mask: Mask, patch: int) -> npt.NDArray[np.int32]:
    """Return the number of the cell of each place, -1 where a patch leaves the mask."""
    height, width = mask.shape
    holes = np.zeros((height + 1, width + 1), np.int64)
    holes[1:, 1:] = np.cumsum(np.cumsum(~mask, axis=0), axis=1)
    inside = holes[patch:, patch:] - holes[:-patch, patch:]
    inside = inside - holes[patch:, :-patch] + holes[:-patch, :-patch] == 0
    side = max(patch // 2, 1)
    y, x = np.arange(inside.shape[0]) // side, np.arange(inside.shape[1]) // side
    numbers = y[:, None] * (x[-1] + 1) + x
    cell = np.full(mask.shape, -1, np.int32)
    # Cells without places have no number, so that every number has a share.
    cell[: inside.shape[0], : inside.shape[1]][inside] = np.unique(
        numbers[inside], return_inverse=True
    )[1]
    return cell


def _turned(
    normals: Float, cell: npt.NDArray[np.int32], quarter: int, flip: bool, patch: int
) -> tuple[Float, npt.NDArray[np.int32]]:
    """Turn a detail by quarters counter-clockwise, then mirror it left to right.

    The number of a place is at the first pixel of its patch, which is another corner of the patch
    after the turn.
    """
    x, y, z = normals[..., 0], normals[..., 1], normals[..., 2]
    for _ in range(quarter):
        x, y = -y, x
    turned = np.rot90(np.stack([x, y, z], axis=-1), quarter)
    room = np.rot90(cell[: cell.shape[0] - patch + 1, : cell.shape[1] - patch + 1], quarter)
    if flip:
        turned = turned[:, ::-1] * np.array([-1, 1, 1], np.float32)
        room = room[:, ::-1]
    numbers = np.full(turned.shape[:2], -1, np.int32)
    numbers[: room.shape[0], : room.shape[1]] = room
    return turned, numbers
