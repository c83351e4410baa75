"""Synthesis of a detail component of any size by quilting patches of an exemplar."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import ClassVar

import numpy as np

from acquisition import DataError, MapRows
from acquisition.files import Form, Maps, MapToFill
from processing.detail.seam import SeamSteps
from processing.maps.normal_map import NormalMap, check_normal_map
from processing.stages.stage import Need, NormalRows, Size, Step, computed
from processing.synthesis.exemplar import CLASSES, prepare_exemplar
from processing.synthesis.quilting import (
    ROWS,
    Quilt,
    StripRange,
    check_options,
    overlap_of,
    positions,
    strip_ranges,
)
from processing.synthesis.seam_steps import cut_steps, part_in_middle
from processing.synthesis.spectrum_match import (
    CORRECTED_ROWS,
    KERNEL,
    bands_with_margins,
    filtered_bands,
    matching_kernel,
)
from rig import Progress, no_progress
from rig.arrays import Float32, Int32, UInt8

# Rows of the part in the middle in which steps are measured.
_MEASURED = 1024
# The interpreter, libraries and compiled kernels; the figures, of at most 2048 x 2048 pixels.
_FIXED = 330_000_000
_FIGURES = 300_000_000
_MOST_FIGURES = 2048 * 2048
# Bytes per pixel: of the exemplar and its separation, of each of its copies, and of a sheet in
# memory while it is written.
_EXEMPLAR, _COPY, _SHEET = 70, 28, 16
# Bytes per pixel: of masks while the sheet is on disk, of a strip, and of rows while they are
# filtered.
_ON_DISK, _OF_STRIP, _OF_BAND = 3, 30, 70
_MARGIN = 64


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
    >>> from processing import NormalMap
    >>> from processing.stages import computed
    >>> from processing.synthesis import SynthesisStage
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
        (exemplar,), (height, width) = sizes, self.size
        copies = (4 if self.rotate else 1) * (2 if self.mirror else 1)
        outside = _FIXED + exemplar[0] * exemplar[1] * (_EXEMPLAR + _COPY * copies)
        figures = _FIGURES * min(height * width, _MOST_FIGURES) // _MOST_FIGURES
        whole = outside + figures + _SHEET * height * width
        stride = self.patch - (self.patch // 4 if self.overlap is None else self.overlap)
        strip = min(ROWS * stride + self.patch, height) * _OF_STRIP
        band = min(CORRECTED_ROWS + _MARGIN, height) * _OF_BAND
        least = outside + _ON_DISK * height * width + max(figures, width * max(strip, band))
        return Need(whole, min(least, whole), f"a sheet of {width} x {height} pixels")

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

    @property
    def _overlap(self) -> int:
        return overlap_of(self.patch, self.overlap)

    def _grid(self) -> tuple[Int32, Int32]:
        """Check the numbers; return the first row and column of the patches."""
        if min(self.size) < 1:
            raise DataError(f"a sheet of {self.size[1]} x {self.size[0]} pixels has no pixels")
        check_options(self.patch, self._overlap, self.seed)
        rows, columns = (
            positions(length, self.patch, self._overlap, self.tileable) for length in self.size
        )
        return rows, columns

    def _strips(self) -> list[StripRange]:
        return strip_ranges(self._grid()[0], self.size[0], self.patch, wrapped=self.tileable)

    def steps(self, maps: Maps, *inputs: NormalRows, memory: int | None = None) -> list[Step]:
        """Return the steps: quilting, softening of the cuts, and filtering."""
        (given,) = inputs
        exemplar = NormalMap(given.normals[:], given.mask)
        overlap, grid, strips = self._overlap, self._grid(), self._strips()
        made = prepare_exemplar(exemplar, self.patch, rotate=self.rotate, mirror=self.mirror)
        quilt = Quilt(made, self.size, *grid, self.patch, overlap, self.seed, self.tileable)
        height, wrapped = self.size[0], self.tileable
        sheet, labels = maps["sheet"], maps["labels"]
        softened = sheet if memory is None else maps["softened"]

        def place(one: slice) -> Iterator[float]:
            yield from self._place(maps, quilt, strips, one.start)

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
        rows = ROWS * (self.patch - overlap)
        return [
            Step("place", len(strips), place, 1, rows),
            Step("measure steps", 1, measure_steps),
            Step("soften", count, soften, most, CORRECTED_ROWS),
            Step("measure spectrum", 1, measure_spectrum),
            Step("filter", count, filter_sheet, most, CORRECTED_ROWS),
        ]

    def cut_steps(self, maps: Mapping[str, MapRows]) -> SeamSteps:
        """Return the steps of `Synthesis.steps`."""
        return cut_steps(maps["sheet"], maps["labels"], wrapped=self.tileable)

    def middle(self, maps: Mapping[str, MapRows]) -> NormalMap:
        """Return the part in the middle that `texture_figures` measures."""
        part: Float32 = part_in_middle(maps["sheet"])
        return NormalMap(part, np.ones(part.shape[:2], np.bool_))

    def _place(
        self, maps: Maps, quilt: Quilt, strips: list[StripRange], number: int
    ) -> Iterator[float]:
        """Place the patches of a strip; what the next one begins with is in the maps."""
        part, patch, width = strips[number], self.patch, self.size[1]
        before, after, upper = (slot * patch for slot in ((number - 1) % 2, number % 2, 2))
        normals = np.zeros((part.rows, width, 3), np.float32)
        labels = np.zeros((part.rows, width), np.uint8)
        both = (
            (normals, maps["sheet"], maps["edges"]),
            (labels, maps["labels"], maps["edge_labels"]),
        )
        uses, placed, known = np.zeros(len(quilt.exemplar.shares)), 0, 0
        if number:
            placed, *others = maps["uses"][number - 1 : number][0]
            uses[:], placed = others[: len(uses)], int(placed)
            known = strips[number - 1].rows - strips[number - 1].done
        for filled, _, edge in both:
            filled[:known] = edge[before : before + known]
            if part.around:
                filled[-part.around :] = edge[upper : upper + part.around]
        placed = yield from quilt.fill_strip(part, normals, labels, uses, placed)
        for filled, whole, edge in both:
            whole[part.top : part.top + part.done] = filled[: part.done]
            if part.around:
                whole[: part.around] = filled[-part.around :]
            if not number:
                first = filled[: min(patch, part.done)]
                edge[upper : upper + len(first)] = first
            edge[after : after + part.rows - part.done] = filled[part.done :]
        state = np.zeros((1, 1 + CLASSES))
        state[0, : 1 + len(uses)] = placed, *uses
        maps["uses"][number : number + 1] = state

    @staticmethod
    def _replace(
        bands: slice,
        before: MapToFill,
        after: MapToFill,
        made: Iterator[tuple[slice, Float32]] | None,
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


def softening_share(sheet: MapRows, labels: MapRows) -> float:
    """Return the share that the pixels at a cut take of each other; 0 if none is needed.

    It makes the mean step across cuts as large as that inside patches. A step of d between the two
    pixels at a straight cut becomes (1 - 2 s) d if each takes a share s of the other: if steps
    across cuts are a tenth larger, the share is 0.045.

    Parameters
    ----------
    sheet
        ``(H, W, 3)`` unit vectors.
    labels
        ``(H, W)`` numbers of the patches.
    """
    height = labels.shape[0]
    middle = slice(max(0, height - _MEASURED) // 2, max(0, height - _MEASURED) // 2 + _MEASURED)
    ratio = cut_steps(part_in_middle(sheet, middle), part_in_middle(labels, middle)).ratio
    return (1 - 1 / ratio) / 2 if ratio > 1 else 0.0


def softened_bands(
    sheet: MapRows, labels: MapRows, share: float, *, wrapped: bool, begin: int = 0
) -> Iterator[tuple[slice, Float32]]:
    """Yield bands of rows whose cuts are softened, beginning with a band."""
    height = labels.shape[0]
    for rows, band in bands_with_margins(sheet, 1, wrapped=wrapped, begin=begin):
        first, last = rows.start, rows.stop
        before = labels[first - 1 : first] if first else labels[height - 1 : height]
        after = labels[last : last + 1] if last < height else labels[:1]
        numbers = np.concatenate([before, labels[rows], after])
        if not wrapped and first == 0:
            numbers[0] = numbers[1]
        if not wrapped and last == height:
            numbers[-1] = numbers[-2]
        yield rows, _softened(band, numbers, share, wrapped=wrapped)[1:-1]


def _softened(rows: Float32, labels: UInt8, share: float, *, wrapped: bool) -> Float32:
    """Return rows in which the pixels on both sides of a cut took a share of each other."""
    softened = rows.copy()
    for axis in (0, 1):
        # The first row and column have no neighbour before them, unless columns are wrapped.
        cut = labels != np.roll(labels, 1, axis)
        if axis == 0 or not wrapped:
            cut[(slice(None),) * axis + (0,)] = False
        here = np.nonzero(cut)
        before = (here[0] - 1, here[1]) if axis == 0 else (here[0], here[1] - 1)
        step = np.float32(share) * (rows[here] - rows[before])
        softened[here] -= step
        softened[before] += step
    return np.asarray(softened / np.linalg.norm(softened, axis=2, keepdims=True), np.float32)


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A synthesised detail component.

    Parameters
    ----------
    detail
        The sheet: unit vectors of the exemplar, known everywhere.
    labels
        ``(H, W)`` uint8: pixels of the same patch have the same number, pixels of patches that
        touch have different ones.
    patch, overlap
        Side of the patches, and the least width of their overlap, in pixels.
    tileable
        Whether the last column and row continue at the first ones.
    """

    detail: NormalMap
    labels: UInt8
    patch: int
    overlap: int
    tileable: bool

    def __repr__(self) -> str:
        used = f"patch={self.patch}, overlap={self.overlap}"
        return f"Synthesis({self.detail!r}, {used}{', tileable' if self.tileable else ''})"

    @cached_property
    def steps(self) -> SeamSteps:
        """Mean angles between neighbouring normals, across cuts and inside patches."""
        return cut_steps(self.detail.normals, self.labels, wrapped=self.tileable)


def synthesize(
    exemplar: NormalMap,
    size: tuple[int, int],
    *,
    patch: int = 48,
    overlap: int | None = None,
    seed: int = 0,
    rotate: bool = False,
    mirror: bool = False,
    tileable: bool = False,
    on_progress: Progress = no_progress,
) -> Synthesis:
    """Continue a detail component over a sheet of any size by image quilting.

    Patches of the exemplar are placed in rows and columns so that they agree where they overlap,
    and are joined along cuts where they differ least (Efros and Freeman, *Image Quilting for
    Texture Synthesis and Transfer*, 2001). Flat and steep parts of the exemplar are used as often
    as they occur, so that the sheet is as steep as the exemplar. Where the mean step across cuts is
    larger than inside patches, the two pixels at each cut take a small share of each other. One
    filter gives the sheet the spectrum of the exemplar. All vectors have unit length.

    Parameters
    ----------
    exemplar
        Detail component, for instance of `separate`. Patches lie inside its mask.
    size
        (height, width) of the sheet in pixels.
    patch
        Side of the square patches in pixels, at least 6. Structures larger than a patch are lost.
    overlap
        Width of the overlap of neighbouring patches in pixels, 2 to a third of the patch. Default:
        a quarter of the patch.
    seed
        Fixes all random choices, 0 to 2^63 - 1. The result does not depend on the number of
        threads.
    rotate, mirror
        Also use copies of the exemplar that are turned by 90, 180 and 270 degrees, or mirrored,
        with their normals.
    tileable
        The last column and row continue at the first ones, so that the sheet can be repeated.
    on_progress
        Receives the stage ``synthesising``, in rows of all steps.

    Returns
    -------
    Synthesis
        The sheet, float32.

    Raises
    ------
    DataError
        If the exemplar is smaller than a patch, flat, or its mask has no room for a patch; if a
        number is out of range; if the sheet is too small for tiling or too large for the memory.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, synthesize
    >>> noise = np.random.default_rng(0).normal(scale=0.2, size=(64, 64, 3))
    >>> rough = NormalMap.from_vectors(noise + [0, 0, 1])
    >>> synthesize(rough, (100, 150), patch=16).detail
    NormalMap(float32[100, 150, 3], 15000 normals)
    """
    check_normal_map("exemplar", exemplar)
    stage = SynthesisStage(size, patch, overlap, seed, rotate, mirror, tileable)
    try:
        maps = computed(stage, exemplar, on_progress=on_progress)
        mask = np.ones(size, np.bool_)
    except MemoryError as error:
        raise DataError(
            f"a sheet of {size[1]} x {size[0]} pixels does not fit into the memory: it needs "
            f"{14 * size[0] * size[1] / 1e9:.1f} GB"
        ) from error
    detail = NormalMap.of_unit_vectors(maps["sheet"][:], mask)
    return Synthesis(detail, maps["labels"][:], patch, overlap_of(patch, overlap), tileable)
