"""The steps of a transfer of detail whose maps are in files."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from acquisition import BandFile, BandStore, ComputedRows, DataError
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
from processing._detail.transfer_rows import PlacedDetail, refined, transferred
from processing._metrics import angle_map_deg
from rig import Progress

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Masks = tuple[Mask, Mask]
Form = tuple[tuple[int, ...], type[np.generic]]

# Bytes for each pixel of the rectangle and of a row of copies while cuts are found.
_RECTANGLE, _COPIES = 40, 12


class TransferStages:
    """The steps of a transfer, whose rows one journal counts, one step after the other.

    First the rows of the source are separated and one unit finds the cuts between its copies. Then
    the rows of the target receive the detail, are corrected as often as wanted, and are measured.

    Parameters
    ----------
    sizes
        Sizes of the maps, filter and number of corrections.
    tile
        How copies are joined; None if the source is put at a place.
    amplitude, keep_target_detail
        As for `transfer`.
    """

    def __init__(
        self, sizes: TransferSizes, tile: Tile | None, amplitude: float, *, keep_target_detail: bool
    ) -> None:
        self._sizes, self._tile, self._amplitude = sizes, tile, amplitude
        self._keep = keep_target_detail
        self._way: Cover | None = None
        # Corrections read one of these maps and write the other one.
        self._states = ("normals", "refined") if sizes.refine else ("normals",)
        self.result = self._states[sizes.refine % len(self._states)]

    @property
    def units(self) -> int:
        """Number of rows of all steps, and one for the cuts."""
        return self._sizes.source[0] + 1 + (2 + self._sizes.refine) * self._sizes.target[0]

    @property
    def forms(self) -> dict[str, Form]:
        """Shapes and types of the maps."""
        source, target = self._sizes.source, self._sizes.target
        vectors: tuple[Form, Form] = ((*source, 3), np.float32), ((*target, 3), np.float32)
        forms: dict[str, Form] = dict.fromkeys(("source", "source_detail"), vectors[0])
        forms["target"] = vectors[1]
        forms |= dict.fromkeys(("shape", *self._states), vectors[1])
        forms |= dict.fromkeys(("shape_error", "detail_error"), (target, np.float32))
        if self._tile == "cut":
            forms["copies"] = (target, np.int32)
        return {**forms, "received": (target, np.bool_), "sums": ((target[0], COLUMNS), np.float64)}

    def placement(
        self, store: BandStore, masks: Masks, at: tuple[int, int] | None, memory: int
    ) -> Placement:
        """Return the position of the source on the target, whose cuts may not be found yet.

        Raises
        ------
        DataError
            As `place_at` and `Cover.of`; if cuts need more memory.
        """
        if at is not None or self._tile is None:
            return place_at(*masks, at or (0, 0))
        way = Cover.of(*masks, self._tile)
        if not way.is_cut:
            return way.placement(self._tile, None)
        _, _, width, height = way.window
        needed = height * (width * _RECTANGLE + way.size[1] * _COPIES)
        if needed > self._sizes.spare(memory):
            missing = needed - self._sizes.spare(memory)
            raise DataError(
                f"the copies of a source of {width} x {height} pixels that are joined along cuts "
                f"need {(memory + missing) / 2**20:.0f}M of memory, {memory / 2**20:.0f}M are "
                "allowed: allow more, or repeat the source without cuts"
            )
        self._way = way
        return way.placement(self._tile, store["copies"])

    def fill(
        self,
        store: BandStore,
        masks: Masks,
        placement: Placement,
        memory: int,
        on_progress: Progress,
    ) -> None:
        """Compute all rows that are missing."""
        height, of_source = self._sizes.target[0], self._sizes.source[0]
        by, count = self._sizes.shape_filter, self._sizes.band_rows(memory)
        paper = ShapeFilter("gaussian", 1, by.w)
        source, mask = store["source"], masks[0]
        detail = PlacedDetail(store["source_detail"], mask, masks[1], placement, self._amplitude)
        of_paper = ComputedRows(
            source.shape,
            source.dtype,
            lambda rows: separate_rows(source, mask, rows, shape_filter=paper)[1],
        )
        as_paper = PlacedDetail(of_paper, mask, masks[1], placement, self._amplitude)

        def separate(rows: slice) -> None:
            _, store["source_detail"][rows] = separate_rows(source, mask, rows, shape_filter=by)

        def cut(_: slice) -> None:
            if self._way is not None:
                self._way.cut(store["source_detail"], store["copies"])

        def receive(rows: slice) -> None:
            target = store["target"]
            shape, _ = separate_rows(target, masks[1], rows, shape_filter=by)
            placed, received = detail.rows(rows)
            own = target[rows]
            store["shape"][rows], store["received"][rows] = shape, received
            ground = own if self._keep else shape
            store["normals"][rows] = transferred(placed, received, ground, own)

        def corrected(before: BandFile, after: BandFile) -> Callable[[slice], None]:
            def correct(rows: slice) -> None:
                has, _ = separate_rows(before, masks[1], rows, shape_filter=by)
                received = store["received"][rows]
                after[rows] = refined(before[rows], received, has, store["shape"][rows])

            return correct

        def measure(rows: slice) -> None:
            self._measure(store, masks[1], rows, detail, as_paper, paper)

        maps = [
            store[self._states[done % len(self._states)]] for done in range(self._sizes.refine + 1)
        ]
        steps: list[tuple[int, Callable[[slice], None]]] = [(of_source, separate), (1, cut)]
        steps.append((height, receive))
        steps += [(height, corrected(*pair)) for pair in pairwise(maps)]
        steps.append((height, measure))
        missing = sum(rows.stop - rows.start for rows in store.missing())
        on_progress("transferring", self.units - missing, self.units)
        begin = 0
        for length, step in steps:
            for rows in store.missing_bands(count, slice(begin, begin + length)):
                step(rows)
                store.complete(slice(begin + rows.start, begin + rows.stop))
                on_progress("transferring", begin + rows.stop, self.units)
            begin += length

    def _measure(
        self,
        store: BandStore,
        mask: Mask,
        rows: slice,
        detail: PlacedDetail,
        as_paper: PlacedDetail,
        paper: ShapeFilter,
    ) -> None:
        """Write errors and sums of some rows."""
        normals, by, height = store[self.result], self._sizes.shape_filter, len(mask)
        wide = slice(max(rows.start - AROUND, 0), min(rows.stop + AROUND, height))
        inner = slice(rows.start - wide.start, rows.stop - wide.start)
        has = separate_rows(normals, mask, wide, shape_filter=by)
        placed, received = detail.rows(wide)
        wanted = store["shape"][wide], placed
        shapes, details = ((has[k], wanted[k]) for k in (0, 1))
        similar = similarity_sums((shapes, details), mask[wide], received)[inner]
        got = received[inner]
        errors = _errors(wanted, has, inner, got)
        store["shape_error"][rows], store["detail_error"][rows] = errors
        sums = [error_sums(errors, got)]
        del has, shapes, details, errors, wanted
        has = separate_rows(normals, mask, rows, shape_filter=paper)
        wanted = (
            separate_rows(store["target"], mask, rows, shape_filter=paper)[0],
            as_paper.rows(rows)[0],
        )
        sums += [error_sums(_errors(wanted, has, slice(None), got), got), similar]
        del has, wanted
        sums.append(self._border_sums(detail.placement, placed, received, inner, wide))
        store["sums"][rows] = np.concatenate(sums, axis=1)

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

    def figures(self, store: BandStore, mask: Mask) -> TransferFigures:
        """Return the figures after all rows were measured."""
        received = store["received"][:] & mask
        return TransferFigures.of_sums(store["sums"][:], received)


def _errors(
    wanted: tuple[Float, Float], has: tuple[Float, Float], inner: slice, received: Mask
) -> tuple[Float, Float]:
    """Return the angles between what is wanted and what there is, of shapes and of details."""
    shape, detail = (
        angle_map_deg(a[inner], b[inner], received) for a, b in zip(wanted, has, strict=True)
    )
    return shape, detail
