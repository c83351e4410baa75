"""The synthesis of a sheet of detail as a stage: its maps, its steps, its memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from acquisition import Form, MapRows, Maps, MapToFill
from processing._normal_map import NormalMap
from processing._stages.stage import Need, NormalRows, Size, Step
from processing._synthesis.exemplar import CLASSES
from processing._synthesis.quilting import Quilt, first_pixels, overlap_of
from processing._synthesis.seam_steps import CutSteps, cut_steps, part_in_middle
from processing._synthesis.softened_cuts import softened_bands, softening_share
from processing._synthesis.spectrum_match import KERNEL, filtered_bands, matching_kernel
from processing._synthesis.strips import CORRECTED_ROWS, ROWS, Begun, StripRange, strip_ranges
from processing._synthesis.synthesis_memory import memory_need


@dataclass(frozen=True)
class SynthesisStage:
    """The synthesis of a sheet from an exemplar by quilting.

    First the patches are placed in strips. Then the cuts are softened and the sheet is filtered,
    in this order, because softened cuts have less power at high frequencies. The maps of the result
    are ``sheet`` ``(H, W, 3)`` and ``labels`` ``(H, W)``, see `Synthesis`.

    Parameters
    ----------
    size, patch, overlap, seed, rotate, mirror, tileable
        As for `synthesize`.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, SynthesisStage, computed
    >>> noise = np.random.default_rng(0).normal(scale=0.2, size=(64, 64, 3))
    >>> rough = NormalMap.from_vectors(noise + [0, 0, 1])
    >>> computed(SynthesisStage((100, 150), patch=16), rough)["sheet"].shape
    (100, 150, 3)
    """

    name: ClassVar = "synthesising"

    size: Size
    patch: int = 48
    overlap: int | None = None
    seed: int = 0
    rotate: bool = False
    mirror: bool = False
    tileable: bool = False

    def need(self, *sizes: Size) -> Need:
        """Return the memory for an exemplar of (height, width)."""
        copies = (4 if self.rotate else 1) * (2 if self.mirror else 1)
        return memory_need(sizes[0], self.size, self.patch, self.overlap, copies)

    def forms(self, *sizes: Size) -> Mapping[str, Form]:
        """Return shapes and types of the maps."""
        (height, width), strips = self.size, len(self._strips())
        vectors = (height, width, 3), np.float32
        # What the next strip begins with, for even and odd strips, then the sheet's upper rows.
        edges = 3 * self.patch, width
        return {
            "sheet": vectors,
            # In files, so that a step can be repeated.
            "softened": vectors,
            "labels": ((height, width), np.uint8),
            "edges": ((*edges, 3), np.float32),
            "edge_labels": (edges, np.uint8),
            # After each strip: number of patches, and uses of classes.
            "uses": ((strips, 1 + CLASSES), np.float64),
            "share": ((1,), np.float64),
            # The first row is 0 without a filter.
            "kernel": ((KERNEL[0] + 1, KERNEL[1]), np.float32),
        }

    def _strips(self) -> list[StripRange]:
        overlap = overlap_of(self.patch, self.overlap)
        tops, _ = first_pixels(self.size, self.patch, overlap, self.seed, tileable=self.tileable)
        return strip_ranges(tops, self.size[0], self.patch, wrapped=self.tileable)

    def steps(self, maps: Maps, *inputs: NormalRows, memory: int | None = None) -> list[Step]:
        """Return the steps: quilting, softening of the cuts, and filtering."""
        (given,) = inputs
        exemplar = NormalMap(given.normals[:], given.mask)
        quilt = Quilt.of(
            exemplar, self.size, self.patch, self.overlap, self.seed,
            rotate=self.rotate, mirror=self.mirror, tileable=self.tileable,
        )  # fmt: skip
        height, wrapped = self.size[0], self.tileable
        sheet, labels = maps["sheet"], maps["labels"]
        softened = sheet if memory is None else maps["softened"]

        def place(strips: slice) -> Iterator[float]:
            yield from self._place(maps, quilt, strips.start)

        def measure_steps(_: slice) -> None:
            maps["share"][0:1] = np.array([softening_share(sheet, labels)])

        def soften(bands: slice) -> Iterator[float]:
            share = float(maps["share"][0:1][0])
            made = softened_bands(sheet, labels, share, wrapped=wrapped, begin=bands.start)
            yield from self._replace(bands, sheet, softened, made if share else None)

        def measure_spectrum(_: slice) -> None:
            kernel = matching_kernel(softened, exemplar)
            if kernel is not None:
                maps["kernel"][0:1] = np.ones((1, KERNEL[1]))
                maps["kernel"][1 : 1 + KERNEL[0]] = kernel

        def filter_sheet(bands: slice) -> Iterator[float]:
            kernel = maps["kernel"][0 : 1 + KERNEL[0]]
            made = filtered_bands(softened, kernel[1:], wrapped=wrapped, begin=bands.start)
            yield from self._replace(bands, softened, sheet, made if kernel[0, 0] else None)

        count = -(-height // CORRECTED_ROWS)
        most = None if memory is None else 1
        rows = ROWS * (self.patch - quilt.overlap)
        return [
            Step("place", len(quilt.strips), place, 1, rows),
            Step("measure steps", 1, measure_steps),
            Step("soften", count, soften, most, CORRECTED_ROWS),
            Step("measure spectrum", 1, measure_spectrum),
            Step("filter", count, filter_sheet, most, CORRECTED_ROWS),
        ]

    def cut_steps(self, maps: Mapping[str, MapRows]) -> CutSteps:
        """Return the steps of `Synthesis.steps`."""
        return cut_steps(maps["sheet"], maps["labels"], wrapped=self.tileable)

    def middle(self, maps: Mapping[str, MapRows]) -> NormalMap:
        """Return the part in the middle that `texture_figures` measures."""
        part: npt.NDArray[np.float32] = part_in_middle(maps["sheet"])
        return NormalMap(part, np.ones(part.shape[:2], np.bool_))

    def _place(self, maps: Maps, quilt: Quilt, strip: int) -> Iterator[float]:
        """Place the patches of a strip; the state after it is in the maps."""
        part, begun = quilt.strips[strip], self._begun(maps, quilt, strip)
        filled, uses, placed = yield from quilt.fill_strip(part, begun)
        after = begun.after(part, filled, maps["sheet"], maps["labels"], self.patch, uses, placed)
        if not strip:
            self._write_edge(maps, 2, after.upper, after.upper_labels)
        self._write_edge(maps, strip % 2, after.normals, after.labels)
        state = np.zeros((1, 1 + CLASSES))
        state[0, 0], state[0, 1 : 1 + len(after.uses)] = after.placed, after.uses
        maps["uses"][strip : strip + 1] = state

    def _begun(self, maps: Maps, quilt: Quilt, strip: int) -> Begun:
        """Return the sheet as it is before a strip."""
        nothing = quilt.nothing()
        if not strip:
            return nothing
        state = maps["uses"][strip - 1 : strip][0]
        before = quilt.strips[strip - 1]
        upper = min(self.patch, quilt.strips[0].done)
        return Begun(
            strip,
            state[1 : 1 + len(nothing.uses)].copy(),
            int(state[0]),
            *self._edge(maps, (strip - 1) % 2, before.rows - before.done),
            *self._edge(maps, 2, upper),
        )

    def _edge(
        self, maps: Maps, slot: int, rows: int
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
        part = slice(slot * self.patch, slot * self.patch + rows)
        return maps["edges"][part], maps["edge_labels"][part]

    def _write_edge(
        self,
        maps: Maps,
        slot: int,
        normals: npt.NDArray[np.float32],
        labels: npt.NDArray[np.uint8],
    ) -> None:
        part = slice(slot * self.patch, slot * self.patch + len(labels))
        maps["edges"][part], maps["edge_labels"][part] = normals, labels

    @staticmethod
    def _replace(
        bands: slice,
        before: MapToFill,
        after: MapToFill,
        made: Iterator[tuple[slice, npt.NDArray[np.float32]]] | None,
    ) -> Iterator[float]:
        """Write bands of corrected rows, or copy them if there is no correction."""
        count = bands.stop - bands.start
        if made is not None:
            for number, (rows, band) in enumerate(islice(made, count), 1):
                after[rows] = band
                yield number / count
        elif before is not after:
            height = before.shape[0]
            rows = slice(bands.start * CORRECTED_ROWS, min(bands.stop * CORRECTED_ROWS, height))
            after[rows] = before[rows]
