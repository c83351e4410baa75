"""Transfer of the detail of one surface to the shape of another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from acquisition.files import MemoryMaps
from processing.detail.choices import Tile
from processing.detail.placement import Placement
from processing.detail.seam import SeamSteps, border_steps
from processing.detail.separation import Separation, mean_over, separate
from processing.detail.shape_filter import ShapeFilter
from processing.detail.transfer_stage import TransferStage, scale_slopes
from processing.maps.metrics import angle_map_deg
from processing.maps.normal_map import NormalMap, check_normal_map
from processing.stages.stage import run_steps
from rig import Progress, no_progress
from rig.arrays import Float32


@dataclass(frozen=True, eq=False)
class TransferFidelity:
    """How well a result preserves the shape and the detail it was made from, for one filter.

    Parameters
    ----------
    shape
        The target's shape component.
    detail
        The detail as it was placed on the target.
    result
        The result, separated again by the same filter.
    """

    shape: NormalMap
    detail: NormalMap
    result: Separation

    def __repr__(self) -> str:
        return f"TransferFidelity({self.result!r})"

    @cached_property
    def shape_error_deg(self) -> Float32:
        """``(H, W)`` angle between the intended shape and the shape of the result, NaN outside."""
        return angle_map_deg(self.shape.normals, self.result.shape.normals, self.detail.mask)

    @cached_property
    def detail_error_deg(self) -> Float32:
        """``(H, W)`` angle between the intended and the resulting detail, NaN outside."""
        return angle_map_deg(self.detail.normals, self.result.detail.normals, self.detail.mask)

    @cached_property
    def shape_mae_deg(self) -> float:
        """Mean shape error over every pixel that received detail."""
        return mean_over(self.shape_error_deg, self.detail.mask)

    @cached_property
    def detail_mae_deg(self) -> float:
        """Mean detail error over every pixel that received detail."""
        return mean_over(self.detail_error_deg, self.detail.mask)


def fidelity_of(
    result: NormalMap,
    target: NormalMap,
    placed_detail: Callable[[ShapeFilter], NormalMap],
    shape_filter: ShapeFilter,
) -> TransferFidelity:
    """Compare a result with its target's shape and the transferred detail, for one filter."""
    return TransferFidelity(
        shape_filter.shape(target),
        placed_detail(shape_filter),
        separate(result, shape_filter=shape_filter),
    )


@dataclass(frozen=True, eq=False)
class TransferResult:
    """The result of a transfer; its errors are computed on demand.

    Parameters
    ----------
    normal_map
        The target with the source's detail; known over the target's mask.
    source, target
        The input maps.
    shape_filter
        The filter that separated them.
    amplitude
        Factor on the slopes of the detail.
    placement
        Position of the source on the target.
    shape, detail
        The target's shape component, and the detail as it was placed on the target.
    """

    normal_map: NormalMap
    source: NormalMap
    target: NormalMap
    shape_filter: ShapeFilter
    amplitude: float
    placement: Placement
    shape: NormalMap
    detail: NormalMap

    def __repr__(self) -> str:
        used = f"{self.shape_filter!r}, amplitude={self.amplitude:g}"
        return f"TransferResult({self.normal_map!r}, {used})"

    @cached_property
    def fidelity(self) -> TransferFidelity:
        """Shape and detail errors with the filter that separated the maps."""
        parts = separate(self.normal_map, shape_filter=self.shape_filter)
        return TransferFidelity(self.shape, self.detail, parts)

    @cached_property
    def fidelity_paper(self) -> TransferFidelity:
        """The same errors with the paper's filter (a Gaussian of order 1)."""
        paper = self.shape_filter.paper
        return fidelity_of(self.normal_map, self.target, self._placed_detail, paper)

    @cached_property
    def seam(self) -> SeamSteps:
        """Steps of the placed detail across the borders of the copies of its source, and inside."""
        return border_steps(self.detail, self.placement.labels(self.target.size))

    def _placed_detail(self, by: ShapeFilter) -> NormalMap:
        detail = self.placement.place(separate(self.source, shape_filter=by).detail, self.target)
        return scale_slopes(detail, self.amplitude)


def transfer(
    source: NormalMap,
    target: NormalMap,
    *,
    keep_target_detail: bool = False,
    amplitude: float = 1.0,
    refine: int = 0,
    shape_filter: ShapeFilter = ShapeFilter(),
    at: tuple[int, int] | None = None,
    tile: Tile = "cut",
    on_progress: Progress = no_progress,
) -> TransferResult:
    """Transfer the detail of a source to the shape of a target (eq. ``eq_transfer`` of the paper).

    The maps are never resized. Without `at`, the largest rectangle inside the source's mask fills
    the target: it is cropped to its middle if it is larger, and tiled if it is smaller.

    Parameters
    ----------
    source
        The map whose detail is taken.
    target
        The map whose shape is kept.
    keep_target_detail
        Add the detail to the target's own normals, including their detail, instead of to the
        target's shape. The paper's transfer table uses this.
    amplitude
        Factor on the slopes of the detail: 0 for none, 1 for no change; a negative factor inverts
        the relief.
    refine
        Number of corrections that rotate every normal by the rotation from the shape of the result
        to the shape of the target. One correction approximately halves the shape error and
        increases the detail error by half. The corrections diverge with a wide box.
    shape_filter
        The filter that separates the maps.
    at
        Column and row of the target at which the source's first pixel is placed; negative values
        are allowed. Target pixels that receive no source pixel inside the mask keep their normals.
    tile
        How copies of a tiled source are joined: ``cut`` lets them overlap by a third of the shorter
        side of the rectangle and joins them along cuts where they differ least; ``plain`` repeats
        the rectangle, which leaves a step at every border; ``mirror`` mirrors every second copy
        with its normals, whose slopes then change their sign at a border.
    on_progress
        Receives the stage ``transferring``, in rows of all steps.

    Returns
    -------
    TransferResult
        The map, and its errors on demand.

    Raises
    ------
    DataError
        If the filter does not fit one of the maps, a number is out of range, or the masks do not
        overlap at `at`.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, transfer
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> ripples = NormalMap.from_vectors(np.dstack([0.2 * np.sin(40 * x), 0 * x, 0 * x + 1]))
    >>> moved = transfer(ripples, bowl)  # the ripples on the bowl
    >>> moved.fidelity.shape_mae_deg < 1
    True
    """
    check_normal_map("source", source)
    check_normal_map("target", target)
    stage = TransferStage(keep_target_detail, amplitude, refine, shape_filter, at, tile)
    maps = MemoryMaps(stage.forms(source.size, target.size))
    steps = stage.steps(maps, source, target)[:-1]  # without the figures
    run_steps(stage.name, steps, maps, on_progress)
    placement = stage.placement(maps, source.mask, target.mask)
    detail = NormalMap.of_unit_vectors(maps["source_detail"][:], source.mask)
    return TransferResult(
        NormalMap(maps[stage.result][:], target.mask),
        source,
        target,
        shape_filter,
        amplitude,
        placement,
        NormalMap.of_unit_vectors(maps["shape"][:], target.mask),
        scale_slopes(placement.place(detail, target), amplitude),
    )
