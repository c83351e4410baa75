"""The transfer of detail as a stage: its maps, its steps, its memory, its figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Form, Maps, MapToFill
from processing._detail.placement import Cover, Placement, place_at
from processing._detail.rows import separate_rows
from processing._detail.seam import border_sums
from processing._detail.shape_filter import ShapeFilter
from processing._detail.tile import Tile
from processing._detail.transfer_figures import (
    COLUMNS,
    TransferFigures,
    error_sums,
    similarity_sums,
)
from processing._detail.transfer_memory import AROUND, TransferSizes
from processing._detail.transfer_rows import (
    PlacedDetail,
    check_amplitude,
    check_steps,
    refined,
    transferred,
)
from processing._metrics import angle_map_deg
from processing._stages.stage import Need, NormalRows, Size, Step, size_of

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Bytes for each pixel of the rectangle and of a row of copies while cuts are found.
_RECTANGLE, _COPIES = 40, 12


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
    >>> from processing import NormalMap, TransferStage, computed
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
        check_steps(self.refine)
        check_amplitude(self.amplitude)

    @property
    def result(self) -> str:
        """Name of the map of the result."""
        return self._states[-1]

    @property
    def _states(self) -> list[str]:
        """The maps of the result before and after each correction."""
        return [("normals", "refined")[done % 2] for done in range(self.refine + 1)]

    @property
    def _paper(self) -> ShapeFilter:
        return ShapeFilter("gaussian", 1, self.shape_filter.w)

    def need(self, *sizes: Size) -> Need:
        """Return the memory for a source and a target."""
        texts = (f"{width} x {height}" for height, width in sizes)
        used = self._sizes(*sizes)
        return Need(used.whole(), used.least(), f"normal maps of {' and '.join(texts)} pixels")

    def _sizes(self, source: Size, target: Size) -> TransferSizes:
        return TransferSizes(source, target, self.shape_filter, self.refine)

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

    def placement(self, maps: Maps, source: Mask, target: Mask) -> Placement:
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

    def _check_cuts(self, way: Cover, sizes: TransferSizes, memory: int) -> None:
        """Refuse copies whose cuts need more memory."""
        _, _, width, height = way.window
        needed = height * (width * _RECTANGLE + way.size[1] * _COPIES)
        if needed > sizes.spare(memory):
            missing = needed - sizes.spare(memory)
            raise DataError(
                f"the copies of a source of {width} x {height} pixels that are joined along cuts "
                f"need {(memory + missing) / 2**20:.0f}M of memory, {memory / 2**20:.0f}M are "
                "allowed: allow more, or repeat the source without cuts"
            )

    def steps(self, maps: Maps, *inputs: NormalRows, memory: int | None = None) -> list[Step]:
        """Return the steps from the separation of the source to the measurement of the result."""
        source, target = inputs
        by, sizes = self.shape_filter, self._sizes(size_of(source), size_of(target))
        placement = self.placement(maps, source.mask, target.mask)
        way = Cover.of(source.mask, target.mask, self.tile) if self._is_cut else None
        if memory is not None and way is not None and way.is_cut:
            self._check_cuts(way, sizes, memory)
        most = None if memory is None else sizes.band_rows(memory)
        masks = source.mask, target.mask
        detail = PlacedDetail(maps["source_detail"], *masks, placement, self.amplitude)

        def separate(rows: slice) -> None:
            for name, used in (("source_detail", by), ("paper_detail", self._paper)):
                parts = separate_rows(source.normals, source.mask, rows, shape_filter=used)
                maps[name][rows] = parts[1]

        def cut(_: slice) -> None:
            if way is not None and way.is_cut:
                way.cut(maps["source_detail"], maps["copies"])

        def receive(rows: slice) -> None:
            shape, _ = separate_rows(target.normals, target.mask, rows, shape_filter=by)
            placed, received = detail.rows(rows)
            own = target.normals[rows]
            maps["shape"][rows], maps["received"][rows] = shape, received
            ground = own if self.keep_target_detail else shape
            maps["normals"][rows] = transferred(placed, received, ground, own)

        def corrected(before: MapToFill, after: MapToFill) -> Callable[[slice], None]:
            def correct(rows: slice) -> None:
                has, _ = separate_rows(before, target.mask, rows, shape_filter=by)
                received = maps["received"][rows]
                after[rows] = refined(before[rows], received, has, maps["shape"][rows])

            return correct

        def measure(rows: slice) -> None:
            self._measure(maps, target, rows, detail)

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
        detail: PlacedDetail,
    ) -> None:
        """Write errors and sums of some rows."""
        normals, mask, by = maps[self.result], target.mask, self.shape_filter
        height, as_paper = len(mask), replace(detail, normals=maps["paper_detail"])
        wide = slice(max(rows.start - AROUND, 0), min(rows.stop + AROUND, height))
        inner = slice(rows.start - wide.start, rows.stop - wide.start)
        has = separate_rows(normals, mask, wide, shape_filter=by)
        placed, received = detail.rows(wide)
        wanted = maps["shape"][wide], placed
        shapes, details = ((has[k], wanted[k]) for k in (0, 1))
        similar = similarity_sums((shapes, details), mask[wide], received)[inner]
        got = received[inner]
        errors = _errors(wanted, has, inner, got)
        maps["shape_error"][rows], maps["detail_error"][rows] = errors
        sums = [error_sums(errors, got)]
        del has, shapes, details, errors, wanted
        has = separate_rows(normals, mask, rows, shape_filter=self._paper)
        wanted = (
            separate_rows(target.normals, mask, rows, shape_filter=self._paper)[0],
            as_paper.rows(rows)[0],
        )
        sums += [error_sums(_errors(wanted, has, slice(None), got), got), similar]
        del has, wanted
        sums.append(self._border_sums(detail.placement, placed, received, inner, wide))
        maps["sums"][rows] = np.concatenate(sums, axis=1)

    def _border_sums(
        self, placement: Placement, placed: Float, received: Mask, inner: slice, wide: slice
    ) -> npt.NDArray[np.float64]:
        count = inner.stop - inner.start
        if placement.tiles == (1, 1):
            return np.zeros((count, 4))
        # With the row below, to which there are steps, too.
        rows = slice(inner.start, min(inner.stop + 1, len(placed)))
        of_target = slice(wide.start + rows.start, wide.start + rows.stop)
        labels = placement.label_rows(of_target, placed.shape[1])
        return border_sums(placed[rows], received[rows], labels)[:count]

    def figures(self, maps: Maps, target: Mask) -> TransferFigures:
        """Return the figures after all rows were measured."""
        return TransferFigures.of_sums(maps["sums"][:], maps["received"][:] & target)


def _errors(
    wanted: tuple[Float, Float], has: tuple[Float, Float], inner: slice, received: Mask
) -> tuple[Float, Float]:
    """Return the angles between what is wanted and what there is, of shapes and of details."""
    shape, detail = (
        angle_map_deg(a[inner], b[inner], received) for a, b in zip(wanted, has, strict=True)
    )
    return shape, detail
