"""Transfer of a part of one surface, for example a face, into another."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numba
import numpy as np

from acquisition import DataError
from processing.detail.detail_transfer import TransferFidelity, fidelity_of, scale_slopes
from processing.detail.rotation import rotate_from_z
from processing.detail.seam import SeamSteps, blend_detail, seam_steps
from processing.detail.separation import separate
from processing.detail.shape_filter import ShapeFilter
from processing.maps.mask import bounding_box
from processing.maps.normal_map import NormalMap, check_mask, check_normal_map
from rig import Progress, in_threads, no_progress, pluralize
from rig.arrays import Bool, Float32, Float64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

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
    def _turn(self) -> Float64:
        """The 2 x 2 rotation and mirroring, x right and y up."""
        angle = math.radians(self.rotate_deg)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        return turn * [-1.0 if self.mirror else 1.0, 1.0]

    @property
    def _back(self) -> Float64:
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

    def place_mask(self, mask: Bool, size: tuple[int, int]) -> Bool:
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


@numba.njit(**PART)
def _weights(fraction: float, out: Float64) -> None:
    """Write the weights of the pixels at -1, 0, 1 and 2; exact for quadratic functions."""
    f = fraction
    out[0] = f * (-0.5 + f * (1 - 0.5 * f))
    out[1] = 1 + f * f * (-2.5 + 1.5 * f)
    out[2] = f * (0.5 + f * (2 - 1.5 * f))
    out[3] = f * f * (-0.5 + 0.5 * f)


@numba.njit(**PART)
def _split(position: float) -> tuple[int, float]:
    """Return the integer and fractional part; remove rounding errors close to a pixel."""
    nearest = round(position)
    if abs(position - nearest) < _ON_PIXEL:
        return int(nearest), 0.0
    whole = math.floor(position)
    return int(whole), position - whole


@numba.njit(nogil=True, cache=True)
def _sample(
    first: int, last: int, vectors: Float32, mask: Bool, back: Float64, out: Float32, known: Bool
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


@dataclass(frozen=True, eq=False)
class LocalTransferResult:
    """The result of a local transfer; its errors are computed on demand.

    Parameters
    ----------
    normal_map
        The target with the inserted part; known over the target's mask.
    target
        The input target.
    region
        ``(H, W)`` bool, the pixels of the target that received the part.
    placed
        The source in the pixels of the target, with its normals rotated accordingly.
    placement
        The transform from the source to the target.
    shape_filter
        The filter that separated both maps.
    amplitude
        Factor on the slopes of the detail.
    """

    normal_map: NormalMap
    target: NormalMap
    region: Bool
    placed: NormalMap
    placement: Similarity
    shape_filter: ShapeFilter
    amplitude: float

    def __repr__(self) -> str:
        pixels = pluralize(int(np.count_nonzero(self.region)), "pixel")
        return f"LocalTransferResult({self.normal_map!r}, region of {pixels}, {self.placement!r})"

    @cached_property
    def fidelity(self) -> TransferFidelity:
        """Errors in the region, blending included, with the filter that separated the maps."""
        return fidelity_of(self.normal_map, self.target, self._placed_detail, self.shape_filter)

    @cached_property
    def fidelity_paper(self) -> TransferFidelity:
        """The same errors with the paper's filter (a Gaussian of order 1)."""
        paper = self.shape_filter.paper
        return fidelity_of(self.normal_map, self.target, self._placed_detail, paper)

    @cached_property
    def seam(self) -> SeamSteps:
        """Angular steps across the seam and inside the region."""
        return seam_steps(self.normal_map, self.region)

    def _placed_detail(self, by: ShapeFilter) -> NormalMap:
        detail = scale_slopes(separate(self.placed, shape_filter=by).detail, self.amplitude)
        return _cut(detail, self.region)


def transfer_local(
    source: NormalMap,
    target: NormalMap,
    *,
    source_mask: Bool | None = None,
    target_mask: Bool | None = None,
    pose: Pose = Pose(),
    amplitude: float = 1.0,
    shape_filter: ShapeFilter = ShapeFilter(w=10),
    reach_px: float | None = None,
    on_progress: Progress = no_progress,
) -> LocalTransferResult:
    """Transfer the coarse detail of a part of a source into a target without a visible seam.

    The source is placed on the target and separated there, so the filter's ``w`` is in pixels of
    the target: the larger ``w``, the coarser the features that are transferred. Inside the region,
    the detail of the source is combined with the shape of the target. A membrane compensates the
    difference to the target's own detail along the seam (see `blend_detail`). Outside the region
    the target does not change.

    Parameters
    ----------
    source
        The map that contains the part.
    target
        The map that receives the part.
    source_mask
        ``(H, W)`` bool of the source's size, the part. Default: the complete source.
    target_mask
        ``(H, W)`` bool of the target's size, the pixels that may receive the part. Default: all.
    pose
        Position, scale, rotation and mirroring of the part on the target. Default position: the
        centre of the target mask's bounding box; without a target mask, and if the maps have the
        same size, the position does not change.
    amplitude
        Factor on the slopes of the detail.
    shape_filter
        The filter that separates the maps.
    reach_px
        Distance from the seam at which the compensated difference has fallen to 1/e. Default: the
        filter's ``w``.
    on_progress
        Receives the stage ``transferring``, five steps.

    Returns
    -------
    LocalTransferResult
        The map, and its errors and seam steps on demand.

    Raises
    ------
    DataError
        If a mask does not fit its map, the masks do not overlap, the position is missing for maps
        of different size, the filter does not fit, or a number is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, ShapeFilter, transfer_local
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> ripples = NormalMap.from_vectors(np.dstack([0.2 * np.sin(40 * x), 0 * x, 0 * x + 1]))
    >>> middle, narrow = x**2 + y**2 < 0.3, ShapeFilter(w=3)
    >>> moved = transfer_local(ripples, bowl, target_mask=middle, shape_filter=narrow).normal_map
    >>> bool((moved.normals == bowl.normals)[~middle].all())  # unchanged outside the region
    True
    """
    check_normal_map("source", source)
    check_normal_map("target", target)
    reach = float(shape_filter.w) if reach_px is None else reach_px
    if not 0 < reach < np.inf:
        raise DataError(f"a blending reach of {reach} px is invalid: give a number above 0")
    part = check_mask("source_mask", source_mask, source.size) & source.mask
    room = check_mask("target_mask", target_mask, target.size) & target.mask
    for name, mask in (("source", part), ("target", room)):
        if not mask.any():
            raise DataError(f"the {name} mask and the {name}'s normals do not overlap")
    if pose.at is None and target_mask is None and source.size != target.size:
        raise DataError(
            f"a source of {_text(source)} pixels has no position on a target of {_text(target)}: "
            "give a position or a target mask"
        )
    anchor = _middle(part)
    at = pose.at
    if at is None:
        at = anchor if target_mask is None else _middle(room)
    on_progress("transferring", 0, 5)
    placement = Similarity(anchor, at, pose.scale, pose.rotate_deg, pose.mirror)
    placed = placement.place(source, target.size)
    region = placement.place_mask(part, target.size) & room
    if placed is None or not (region & placed.mask).any():
        raise DataError(
            f"the source mask placed at {at[0]:g},{at[1]:g} does not overlap the target mask: "
            "choose another position, scale or mask"
        )
    region &= placed.mask
    on_progress("transferring", 1, 5)
    detail = scale_slopes(separate(placed, shape_filter=shape_filter).detail, amplitude)
    on_progress("transferring", 2, 5)
    ground = separate(target, shape_filter=shape_filter)
    on_progress("transferring", 3, 5)
    blended = blend_detail(detail, ground.detail, region, reach)
    on_progress("transferring", 4, 5)
    turned = rotate_from_z(blended, ground.shape.normals)
    normals = np.where(region[..., None], turned, target.normals)
    result = NormalMap(normals, target.mask)
    on_progress("transferring", 5, 5)
    return LocalTransferResult(result, target, region, placed, placement, shape_filter, amplitude)


def _middle(mask: Bool) -> tuple[int, int]:
    """Return the (column, row) of the centre of a mask's bounding box."""
    rows, columns = bounding_box(mask)
    return (columns.start + columns.stop - 1) // 2, (rows.start + rows.stop - 1) // 2


def _cut(normal_map: NormalMap, region: Bool) -> NormalMap:
    return NormalMap(np.where(region[..., None], normal_map.normals, 0), region)


def _text(normal_map: NormalMap) -> str:
    return f"{normal_map.size[1]} x {normal_map.size[0]}"
