"""Synthesis of a detail component of any size by quilting patches of an exemplar."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._normal_map import NormalMap, check_normal_map
from processing._synthesis.exemplar import Exemplar, prepare_exemplar
from processing._synthesis.quilt_kernels import place_patches
from processing._synthesis.seam_steps import CutSteps, cut_steps
from processing._synthesis.softened_cuts import soften_cuts
from processing._synthesis.spectrum_match import match_spectrum
from processing._synthesis.strips import Begun, LabelRows, SheetRows, StripRange, strip_ranges
from rig import Progress, in_threads, no_progress

Whole = npt.NDArray[np.int32]

CANDIDATES = 2400
# How strongly a class of patches that was used often is avoided.
BALANCE = 1.0
# A patch that touches another patch that it does not overlap would depend on the order.
_LEAST_PATCH = 6


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
    labels: npt.NDArray[np.uint8]
    patch: int
    overlap: int
    tileable: bool

    def __repr__(self) -> str:
        used = f"patch={self.patch}, overlap={self.overlap}"
        return f"Synthesis({self.detail!r}, {used}{', tileable' if self.tileable else ''})"

    @cached_property
    def steps(self) -> CutSteps:
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
        Receives the stages ``preparing`` and ``synthesising``, the latter with numbers of patches.

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
    quilt = Quilt.of(
        exemplar, size, patch, overlap, seed, rotate=rotate, mirror=mirror, tileable=tileable,
        on_progress=on_progress,
    )  # fmt: skip
    try:
        sheet = np.zeros((*size, 3), np.float32)
        labels, mask = np.zeros(size, np.uint8), np.ones(size, np.bool_)
    except MemoryError as error:
        raise DataError(
            f"a sheet of {size[1]} x {size[0]} pixels does not fit into the memory: it needs "
            f"{14 * size[0] * size[1] / 1e9:.1f} GB"
        ) from error
    for _ in quilt.fill(sheet, labels, quilt.nothing(), on_progress):
        pass
    # In this order, because softened cuts have less power at high frequencies.
    soften_cuts(sheet, labels, wrapped=tileable)
    match_spectrum(sheet, exemplar, wrapped=tileable)
    detail = NormalMap.of_unit_vectors(sheet, mask)
    return Synthesis(detail, labels, patch, quilt.overlap, tileable)


def overlap_of(patch: int, overlap: int | None) -> int:
    """Return the overlap of patches, of which the default is a quarter."""
    return max(patch // 4, 2) if overlap is None else overlap


def check_options(patch: int, overlap: int, seed: int) -> None:
    """Raise `DataError` if a number is out of range."""
    if patch < _LEAST_PATCH:
        raise DataError(f"a patch of {patch} x {patch} pixels is too small: use {_LEAST_PATCH}")
    if not 2 <= overlap <= patch // 3:
        raise DataError(
            f"an overlap of {overlap} pixels is out of range: patches of {patch} pixels overlap by "
            f"2 to {patch // 3}"
        )
    if not 0 <= seed < 2**63:
        raise DataError(f"a seed of {seed} is out of range: use 0 to 2^63 - 1")


def positions(length: int, patch: int, overlap: int, tileable: bool) -> Whole:
    """Return the first pixel of each patch along one axis."""
    stride = patch - overlap
    if not tileable:
        return np.arange(0, max(length - overlap, 1), stride, dtype=np.int32)
    if length < 2 * patch:
        raise DataError(
            f"a sheet for tiling must be at least {2 * patch} pixels wide and high with patches of "
            f"{patch} pixels, not {length}: use a larger sheet or smaller patches"
        )
    count = -(-length // stride)
    return (np.arange(count) * length // count).astype(np.int32)


@dataclass(frozen=True, eq=False)
class Quilt:
    """What the patches of a sheet are placed from.

    Parameters
    ----------
    exemplar
        The exemplar and its copies.
    size
        (height, width) of the sheet.
    rows, columns
        First pixel of each patch along each axis.
    patch, overlap, seed, tileable
        As for `synthesize`.
    """

    exemplar: Exemplar
    size: tuple[int, int]
    rows: Whole
    columns: Whole
    patch: int
    overlap: int
    seed: int
    tileable: bool

    @classmethod
    def of(
        cls,
        exemplar: NormalMap,
        size: tuple[int, int],
        patch: int,
        overlap: int | None,
        seed: int,
        *,
        rotate: bool,
        mirror: bool,
        tileable: bool,
        on_progress: Progress,
    ) -> Quilt:
        """Check the arguments of `synthesize` and prepare its exemplar."""
        overlap = overlap_of(patch, overlap)
        if min(size) < 1:
            raise DataError(f"a sheet of {size[1]} x {size[0]} pixels has no pixels")
        check_options(patch, overlap, seed)
        on_progress("preparing", 0, 1)
        made = prepare_exemplar(exemplar, patch, rotate=rotate, mirror=mirror)
        rows, columns = (positions(length, patch, overlap, tileable) for length in size)
        return cls(made, size, rows, columns, patch, overlap, seed, tileable)

    @property
    def strips(self) -> list[StripRange]:
        """The strips of the sheet."""
        return strip_ranges(self.rows, self.size[0], self.patch, wrapped=self.tileable)

    def nothing(self) -> Begun:
        """Return the beginning of a sheet."""
        return Begun.nothing(len(self.exemplar.shares), self.size[1])

    def fill(
        self, sheet: SheetRows, labels: LabelRows, begun: Begun, on_progress: Progress
    ) -> Iterator[Begun]:
        """Place the patches that are missing, strip by strip, and yield the sheet after each."""
        total, waits = len(self.rows) * len(self.columns), True
        for part in self.strips[begun.strips :]:
            filled = begun.strip(part)
            uses, placed = begun.uses.copy(), begun.placed
            for patch_of in diagonals(part.last - part.first, len(self.columns), self.tileable):
                uses += self._place(*filled, part, patch_of, uses, placed)
                if waits:  # the first patch waits for the compiler
                    on_progress("preparing", 1, 1)
                    on_progress("synthesising", placed, total)
                    waits = False
                placed += len(patch_of)
                on_progress("synthesising", placed, total)
            begun = begun.after(part, filled, sheet, labels, self.patch, uses, placed)
            yield begun

    def _place(
        self,
        sheet: npt.NDArray[np.float32],
        labels: npt.NDArray[np.uint8],
        part: StripRange,
        patch_of: Whole,
        uses: npt.NDArray[np.float64],
        placed: int,
    ) -> npt.NDArray[np.int64]:
        """Place patches of a strip that touch no common pixel; return how often classes are used.

        Parameters
        ----------
        sheet, labels
            Rows of the strip, written.
        part
            The strip.
        patch_of
            ``(n, 2)``: row in the strip and column of each patch.
        uses, placed
            Uses of each class before, and number of patches.
        """
        rows, columns, patch, made = self.rows, self.columns, self.patch, self.exemplar
        height, width = self.size
        r, c = part.first + patch_of[:, 0], patch_of[:, 1]
        patches = np.stack([r, c, rows[r] - part.top, columns[c]], axis=1).astype(np.int32)
        bands = np.zeros_like(patches)
        bands[:, 0] = np.where(c > 0, columns[c - 1] + patch - columns[c], 0)
        bands[:, 1] = np.where(r > 0, rows[r - 1] + patch - rows[r], 0)
        if self.tileable:
            bands[:, 2] = np.where(c == len(columns) - 1, columns[c] + patch - width, 0)
            bands[:, 3] = np.where(r == len(rows) - 1, rows[r] + patch - height, 0)
        used = np.zeros(len(patches), np.int32)
        penalty = ((uses + 1) / (placed * made.shares + 1)) ** BALANCE
        in_threads(
            place_patches, len(r), sheet, labels, patches, bands, patch, made.vectors, made.slopes,
            made.starts, made.classes, penalty, made.mean_energy, CANDIDATES, self.seed, used,
        )  # fmt: skip
        return np.bincount(used, minlength=len(uses))


def diagonals(rows: int, columns: int, tileable: bool) -> Iterator[Whole]:
    """Yield (row, column) of patches that do not depend on each other, in the order of placing.

    The patches of the last column of a sheet for tiling touch those of the first column in the
    next row, so they follow one by one when all others are placed.
    """
    free = columns - 1 if tileable else columns
    for t in range(free + 2 * (rows - 1)):
        r = np.arange(max(0, (t - free + 2) // 2), min(rows - 1, t // 2) + 1, dtype=np.int32)
        if r.size:
            yield np.stack([r, t - 2 * r], axis=1)
    if tileable:
        for row in range(rows):
            yield np.array([[row, free]], np.int32)
