"""Transfer of the detail of one surface to the shape of another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from acquisition import DataError
from acquisition.files import Form, Maps, MapToFill, MemoryMaps
from processing.detail.choices import Tile
from processing.detail.placement import Cover, Placement, place_at
from processing.detail.rotation import rotate_between, rotate_from_z
from processing.detail.seam import SeamSteps, border_sums, steps_of_sums
from processing.detail.separation import (
    LEAST_ROWS,
    Separation,
    fixed,
    mean_over,
    separate,
    separate_rows,
    sums_of_rows,
    useful_rows,
)
from processing.detail.shape_filter import ShapeFilter
from processing.maps.metrics import Protocol, angle_map_deg, mean_similarity, similarity_of_rows
from processing.maps.normal_map import NormalMap, check_normal_map, directions
from processing.stages.stage import Need, NormalRows, Size, Step, run_steps, size_of
from rig import Progress, check_type, in_threads, no_progress
from rig.arrays import Bool, Float32, Float64

# Rows of a map that the similarity of a row needs above and below.
AROUND = 5
# Bytes per pixel of a band, besides those of its separation: the placed detail, its labels, the
# shapes, the errors and what the similarities need.
_OF_BAND = 110
# Bytes per pixel if both maps are in memory, besides those of the separation: of the target while
# its errors are measured, of the source meanwhile and while it is separated, of a map that waits.
_TARGET, _SOURCE, _SEPARATED, _WAITING = 105, 25, 15, 13
# Bytes per pixel while a map is read; masks need less while the maps are on disk.
_READING = 6
_PROTOCOLS: tuple[Protocol, ...] = ("masked", "paper")
# Columns of the sums: errors, errors with the paper's filter, similarities, steps.
COLUMNS = 2 + 2 + 4 + 4
# Bytes for each pixel of the rectangle and of a row of copies while cuts are found.
_RECTANGLE, _COPIES = 40, 12


def _scaled_slopes(normals: Float32, mask: Bool, amplitude: float) -> tuple[Float32, Bool]:
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
    _check_amplitude(amplitude)
    if amplitude == 1:
        return detail
    return NormalMap(*_scaled_slopes(detail.normals, detail.mask, amplitude))


def _check_amplitude(amplitude: float) -> None:
    """Raise `DataError` if a factor on slopes is not finite."""
    if not np.isfinite(amplitude):
        raise DataError(
            f"a detail amplitude of {amplitude} is not a finite number: use 1 to keep the detail"
        )


@dataclass(frozen=True)
class TransferFigures:
    """Figures of a transfer.

    Parameters
    ----------
    shape_mae_deg, detail_mae_deg
        Mean errors of `TransferFidelity`.
    shape_mae_deg_paper, detail_mae_deg_paper
        The same with the paper's filter.
    shape_ssim, shape_ssim_paper, detail_ssim, detail_ssim_paper
        Similarities of the shapes and of the details, over the pixels that received detail and in
        the protocol of the paper.
    seam
        Steps of the detail across the borders of copies, and inside.
    pixels
        Number of the pixels that received detail.
    """

    shape_mae_deg: float
    detail_mae_deg: float
    shape_mae_deg_paper: float
    detail_mae_deg_paper: float
    shape_ssim: float
    shape_ssim_paper: float
    detail_ssim: float
    detail_ssim_paper: float
    seam: SeamSteps
    pixels: int


def _error_sums(errors: tuple[Float32, Float32], received: Bool) -> Float64:
    """Return ``(n, 2)`` sums over rows of two maps of errors."""
    return np.stack([sums_of_rows(values, received) for values in errors], axis=1)


def _similarity_sums(
    pairs: tuple[tuple[Float32, Float32], tuple[Float32, Float32]], mask: Bool, received: Bool
) -> Float64:
    """Return ``(n, 4)`` sums over rows of the similarities of shapes and of details.

    Parameters
    ----------
    pairs
        Shapes of result and target, then details of the result and of the source.
    mask, received
        Where the target has a normal, and where it received detail.
    """
    masks = (mask, mask), (mask, received)
    return np.stack(
        [
            similarity_of_rows(*pair, known, received, protocol)
            for pair, known in zip(pairs, masks, strict=True)
            for protocol in _PROTOCOLS
        ],
        axis=1,
    )


@dataclass(frozen=True)
class TransferStage:
    """A transfer of detail from a source to the shape of a target.

    First the source is separated and the cuts between its copies are found. Then the rows of the
    target receive the detail, are corrected as often as wanted, and are measured. The maps of the
    result are ``normals`` (or what `result` names) ``(H, W, 3)``, and ``shape_error`` and
    ``detail_error`` ``(H, W)`` in degrees as in `TransferFidelity`.

    Parameters
    ----------
    keep_target_detail, amplitude, refine, shape_filter, at, tile
        As for `transfer`.

    Raises
    ------
    DataError
        If a number is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.detail import TransferStage
    >>> from processing.stages import computed
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> stage = TransferStage()
    >>> maps = computed(stage, bowl, bowl)
    >>> stage.figures(maps, bowl.mask).pixels
    1024
    """

    name: ClassVar = "transferring"

    keep_target_detail: bool = False
    amplitude: float = 1.0
    refine: int = 0
    shape_filter: ShapeFilter = ShapeFilter()
    at: tuple[int, int] | None = None
    tile: Tile = "cut"

    def __post_init__(self) -> None:
        if self.refine < 0:
            raise DataError(f"the number of refinement steps cannot be negative: {self.refine}")
        check_type("shape_filter", self.shape_filter, ShapeFilter, "ShapeFilter(kind, order, w)")
        _check_amplitude(self.amplitude)

    @property
    def result(self) -> str:
        """Name of the map of the result."""
        return self._states[-1]

    @property
    def _states(self) -> list[str]:
        """The maps of the result before and after each correction."""
        return [("normals", "refined")[done % 2] for done in range(self.refine + 1)]

    def need(self, *sizes: Size) -> Need:
        """Return the memory for a source and a target."""
        source, target = (height * width for height, width in sizes)
        filtered = self.shape_filter.pixel_bytes
        whole = fixed() + max(
            source * (_SEPARATED + filtered) + target * _WAITING,
            source * _SOURCE + target * (_TARGET + filtered),
        )
        outside, of_halo, of_row = self._bytes_in_bands(*sizes)
        height = max(height for height, _ in sizes)
        band = min(2 * self._halo, height) * of_halo + min(LEAST_ROWS, height) * of_row
        texts = " and ".join(f"{width} x {height}" for height, width in sizes)
        return Need(whole, min(outside + band, whole), f"normal maps of {texts} pixels")

    @property
    def _halo(self) -> int:
        """Rows above and below a band that it reads."""
        return self.shape_filter.halo + AROUND

    def _bytes_in_bands(self, *sizes: Size) -> tuple[int, int, int]:
        """Return the bytes besides a band, of a row that is only filtered, and of one in it."""
        source, target = (height * width for height, width in sizes)
        outside = max(_READING * source, _READING * target + source)
        width = max(width for _, width in sizes)
        filtered = width * self.shape_filter.pixel_bytes
        return fixed() + outside, filtered, filtered + width * _OF_BAND

    def forms(self, *sizes: Size) -> Mapping[str, Form]:
        """Return shapes and types of the maps."""
        for size in sizes:
            self.shape_filter.check_size(size)
        source, target = sizes
        of_target = dict.fromkeys(("shape", *self._states), ((*target, 3), np.float32))
        errors = dict.fromkeys(("shape_error", "detail_error"), (target, np.float32))
        return {
            **dict.fromkeys(("source_detail", "paper_detail"), ((*source, 3), np.float32)),
            **of_target,
            **errors,
            **({"copies": (target, np.int32)} if self._is_cut else {}),
            "received": (target, np.bool_),
            "sums": ((target[0], COLUMNS), np.float64),
        }

    @property
    def _is_cut(self) -> bool:
        return self.at is None and self.tile == "cut"

    def placement(self, maps: Maps, source: Bool, target: Bool) -> Placement:
        """Return the position of the source on the target, given their masks.

        Raises
        ------
        DataError
            As `place_at` and `Cover.of`.
        """
        if self.at is not None:
            return place_at(source, target, self.at)
        way = Cover.of(source, target, self.tile)
        return way.placement(self.tile, maps["copies"] if way.is_cut else None)

    def steps(self, maps: Maps, *inputs: NormalRows, memory: int | None = None) -> list[Step]:
        """Return the steps from the separation of the source to the measurement of the result."""
        source, target = inputs
        by, placement = self.shape_filter, self.placement(maps, source.mask, target.mask)
        way = Cover.of(source.mask, target.mask, self.tile) if self._is_cut else None
        most = None
        if memory is not None:
            outside, of_halo, of_row = self._bytes_in_bands(size_of(source), size_of(target))
            if way is not None and way.is_cut:
                _check_cuts(way, outside, memory)
            free = memory - outside - 2 * self._halo * of_halo
            most = useful_rows(free // of_row, self._halo)

        def separate(rows: slice) -> None:
            for name, used in (("source_detail", by), ("paper_detail", by.paper)):
                parts = separate_rows(source.normals, source.mask, rows, shape_filter=used)
                maps[name][rows] = parts[1]

        def placed_rows(name: str, rows: slice) -> tuple[Float32, Bool]:
            """Return a detail on some rows of the target, and which pixels receive it."""
            placed = placement.place_rows(maps[name], source.mask, target.mask, rows)
            return _scaled_slopes(*placed, self.amplitude)

        def cut(_: slice) -> None:
            if way is not None and way.is_cut:
                way.cut(maps["source_detail"], maps["copies"])

        def receive(rows: slice) -> None:
            shape, _ = separate_rows(target.normals, target.mask, rows, shape_filter=by)
            placed, received = placed_rows("source_detail", rows)
            own = target.normals[rows]
            maps["shape"][rows], maps["received"][rows] = shape, received
            ground = own if self.keep_target_detail else shape
            turned = rotate_from_z(placed, ground)
            maps["normals"][rows] = np.where(received[..., None], turned, own)

        def corrected(before: MapToFill, after: MapToFill) -> Callable[[slice], None]:
            def correct(rows: slice) -> None:
                has, _ = separate_rows(before, target.mask, rows, shape_filter=by)
                received, own = maps["received"][rows], before[rows]
                turned = rotate_between(own, has, maps["shape"][rows])
                after[rows] = np.where(received[..., None], turned, own)

            return correct

        def measure(rows: slice) -> None:
            self._measure(maps, target, rows, placement, placed_rows)

        height = len(target.mask)
        corrections = pairwise(maps[name] for name in self._states)
        return [
            Step("separate", len(source.mask), separate, most),
            Step("cut", 1, cut),
            Step("receive", height, receive, most),
            *(
                Step(f"correct {number}", height, corrected(*pair), most)
                for number, pair in enumerate(corrections)
            ),
            Step("measure", height, measure, most),
        ]

    def _measure(
        self,
        maps: Maps,
        target: NormalRows,
        rows: slice,
        placement: Placement,
        placed_rows: Callable[[str, slice], tuple[Float32, Bool]],
    ) -> None:
        """Write errors and sums of some rows."""
        normals, mask, by = maps[self.result], target.mask, self.shape_filter
        height, paper = len(mask), by.paper
        wide = slice(max(rows.start - AROUND, 0), min(rows.stop + AROUND, height))
        inner = slice(rows.start - wide.start, rows.stop - wide.start)
        has = separate_rows(normals, mask, wide, shape_filter=by)
        placed, received = placed_rows("source_detail", wide)
        wanted = maps["shape"][wide], placed
        shapes, details = ((has[k], wanted[k]) for k in (0, 1))
        similar = _similarity_sums((shapes, details), mask[wide], received)[inner]
        got = received[inner]
        errors = _errors(wanted, has, inner, got)
        maps["shape_error"][rows], maps["detail_error"][rows] = errors
        sums = [_error_sums(errors, got)]
        del has, shapes, details, errors, wanted
        has = separate_rows(normals, mask, rows, shape_filter=paper)
        shape, _ = separate_rows(target.normals, mask, rows, shape_filter=paper)
        wanted = shape, placed_rows("paper_detail", rows)[0]
        del shape
        sums += [_error_sums(_errors(wanted, has, slice(None), got), got), similar]
        del has, wanted
        sums.append(_border_sums(placement, placed, received, inner, wide))
        maps["sums"][rows] = np.concatenate(sums, axis=1)

    def figures(self, maps: Maps, target: Bool) -> TransferFigures:
        """Return the figures after all rows were measured."""
        sums, received = maps["sums"][:], maps["received"][:] & target
        pixels = int(np.count_nonzero(received))
        columns = [np.ascontiguousarray(column) for column in sums.T]
        means = (float(column.sum() / pixels) for column in columns[:4])
        similarities = (
            mean_similarity(column, received, protocol)
            for column, protocol in zip(columns[4:8], 2 * _PROTOCOLS, strict=True)
        )
        of_fields: list[Any] = [*means, *similarities, steps_of_sums(sums[:, 8:]), pixels]
        return TransferFigures(*of_fields)


def _check_cuts(way: Cover, outside: int, memory: int) -> None:
    """Refuse copies whose cuts need more memory; ``outside`` are the bytes of other things."""
    _, _, width, height = way.window
    needed = outside + height * (width * _RECTANGLE + way.size[1] * _COPIES)
    if needed > memory:
        raise DataError(
            f"the copies of a source of {width} x {height} pixels that are joined along cuts "
            f"need {needed / 2**20:.0f}M of memory, {memory / 2**20:.0f}M are "
            "allowed: allow more, or repeat the source without cuts"
        )


def _errors(
    wanted: tuple[Float32, Float32], has: tuple[Float32, Float32], inner: slice, received: Bool
) -> tuple[Float32, Float32]:
    """Return the angles between what is wanted and what there is, of shapes and of details."""
    shape, detail = (
        angle_map_deg(a[inner], b[inner], received) for a, b in zip(wanted, has, strict=True)
    )
    return shape, detail


def _border_sums(
    placement: Placement, placed: Float32, received: Bool, inner: slice, wide: slice
) -> Float64:
    count = inner.stop - inner.start
    if placement.tiles == (1, 1):
        return np.zeros((count, 4))
    # With the row below, to which there are steps, too.
    rows = slice(inner.start, min(inner.stop + 1, len(placed)))
    of_target = slice(wide.start + rows.start, wide.start + rows.stop)
    labels = placement.label_rows(of_target, placed.shape[1])
    return border_sums(placed[rows], received[rows], labels)[:count]


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
        labels = self.placement.labels(self.target.size)
        return steps_of_sums(border_sums(self.detail.normals, self.detail.mask, labels))

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
