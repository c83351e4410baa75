"""Transfer of a part of one surface, for example a face, into another."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._detail.rotation import rotate_from_z
from processing._detail.seam import SeamSteps, blend_detail, seam_steps
from processing._detail.separation import separate
from processing._detail.shape_filter import ShapeFilter
from processing._detail.similarity import Pose, Similarity
from processing._detail.transfer import TransferFidelity, fidelity_of
from processing._detail.transfer_stage import scale_slopes
from processing._normal_map import NormalMap, check_normal_map
from rig import Progress, no_progress, pluralize

Mask = npt.NDArray[np.bool_]


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
    region: Mask
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
        paper = ShapeFilter("gaussian", 1, self.shape_filter.w)
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
    source_mask: Mask | None = None,
    target_mask: Mask | None = None,
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
    part = _checked(source_mask, source, "source") & source.mask
    room = _checked(target_mask, target, "target") & target.mask
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


def _checked(mask: Mask | None, normal_map: NormalMap, name: str) -> Mask:
    if mask is None:
        return np.ones(normal_map.size, np.bool_)
    if mask.dtype != np.bool_ or mask.shape != normal_map.size:
        raise DataError(
            f"a {name} mask of {mask.dtype} and shape {mask.shape} does not fit a {name} of "
            f"{_text(normal_map)} pixels"
        )
    return mask


def _middle(mask: Mask) -> tuple[int, int]:
    """Return the (column, row) of the centre of a mask's bounding box."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return int(columns[0] + columns[-1]) // 2, int(rows[0] + rows[-1]) // 2


def _cut(normal_map: NormalMap, region: Mask) -> NormalMap:
    return NormalMap(np.where(region[..., None], normal_map.normals, 0), region)


def _text(normal_map: NormalMap) -> str:
    return f"{normal_map.size[1]} x {normal_map.size[0]}"
