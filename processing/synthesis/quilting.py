"""Synthesis of a detail component of any size by quilting patches of an exemplar."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numba
import numpy as np

from acquisition import DataError
from processing.detail.minimum_cuts import taken_pixels
from processing.synthesis.exemplar import Exemplar
from processing.synthesis.patch_search import Bands, find_place, stream
from rig import in_threads
from rig.arrays import Float32, Float64, Int32, Int64, UInt8
from rig.kernels import INLINED

# Compiled in: processing/detail/minimum_cuts.py 595407bbeb71
# Compiled in: processing/synthesis/patch_search.py 1d7cb504f7ac
# Compiled in: rig/kernels/parts.py 986f6e8c38a7
CANDIDATES = 2400
# Rows of patches of a strip: as many threads can place patches of one diagonal.
ROWS = 16
# How strongly a class of patches that was used often is avoided.
BALANCE = 1.0
# A patch that touches another patch that it does not overlap would depend on the order.
_LEAST_PATCH = 6


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
    check_seed(seed)


def check_seed(seed: int) -> None:
    """Raise `DataError` if a seed of random numbers is out of range."""
    if not 0 <= seed < 2**63:
        raise DataError(f"a seed of {seed} is out of range: use 0 to 2^63 - 1")


def positions(length: int, patch: int, overlap: int, tileable: bool) -> Int32:
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


@dataclass(frozen=True)
class StripRange:
    """A part of a sheet in which some rows of patches are placed.

    Parameters
    ----------
    first, last
        Range of the rows of patches.
    top, rows, done
        First row of the sheet, number of rows, and how many of them the next strip leaves as they
        are.
    around
        Number of rows at the end of the strip that are the first rows of the sheet.
    """

    first: int
    last: int
    top: int
    rows: int
    done: int
    around: int


def strip_ranges(tops: Int32, height: int, patch: int, *, wrapped: bool) -> list[StripRange]:
    """Return the strips of a sheet from the top downwards.

    Parameters
    ----------
    tops
        First row of the sheet of each row of patches.
    height
        Rows of the sheet.
    patch
        Side of the patches.
    wrapped
        The last row of patches overlaps the first one. It is a strip of its own, which continues
        with the first rows of the sheet.
    """
    count = len(tops) - wrapped
    starts = [*range(0, count, ROWS), count] if wrapped else [*range(0, count, ROWS)]
    ranges = []
    for first, last in zip(starts, [*starts[1:], len(tops)], strict=True):
        top, bottom = int(tops[first]), int(tops[last - 1]) + patch
        around = max(bottom - height, 0) if wrapped else 0
        rows = min(bottom, height) + around - top
        done = (int(tops[last]) if last < len(tops) else height) - top
        ranges.append(StripRange(first, last, top, rows, done, around))
    return ranges


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
    rows: Int32
    columns: Int32
    patch: int
    overlap: int
    seed: int
    tileable: bool

    def fill_strip(
        self, part: StripRange, sheet: Float32, labels: UInt8, uses: Float64, placed: int
    ) -> Generator[float, None, int]:
        """Place the patches of a strip; yield the share that is done, return their number.

        Parameters
        ----------
        part
            The strip.
        sheet, labels
            Its rows, written.
        uses, placed
            Uses of each class, which are updated, and number of patches before.
        """
        groups = list(diagonals(part.last - part.first, len(self.columns), self.tileable))
        for number, patch_of in enumerate(groups, 1):
            uses += self._place(sheet, labels, part, patch_of, uses, placed)
            placed += len(patch_of)
            yield number / len(groups)
        return placed

    def _place(
        self,
        sheet: Float32,
        labels: UInt8,
        part: StripRange,
        patch_of: Int32,
        uses: Float64,
        placed: int,
    ) -> Int64:
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
            _place_patches, len(r), sheet, labels, patches, bands, patch, made.vectors, made.slopes,
            made.starts, made.classes, penalty, made.mean_energy, CANDIDATES, self.seed, used,
        )  # fmt: skip
        return np.bincount(used, minlength=len(uses))


def diagonals(rows: int, columns: int, tileable: bool) -> Iterator[Int32]:
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


@numba.njit(**INLINED)
def _place(
    sheet: Float32,
    labels: UInt8,
    patch: Int32,
    bands: Bands,
    size: int,
    vectors: Float32,
    slopes: Float32,
    starts: Int32,
    classes: Int32,
    penalty: Float64,
    mean_energy: float,
    candidates: int,
    seed: int,
) -> int:
    """Place one patch and return the class of its exemplar's patch; see `_place_patches`."""
    rows, columns = labels.shape
    top, left = patch[2], patch[3]
    height = size if bands[3] else min(size, rows - top)
    width = size if bands[2] else min(size, columns - left)
    window = np.zeros((height, width, 3), np.float32)
    steep = np.zeros((height, 2 * width), np.float32)
    for r in range(height):
        for c in range(width):
            for k in range(3):
                window[r, c, k] = sheet[(top + r) % rows, (left + c) % columns, k]
            steep[r, 2 * c], steep[r, 2 * c + 1] = window[r, c, 0], window[r, c, 1]
    state = stream(seed, patch[0], patch[1])
    copy, y, x = find_place(
        steep, slopes, starts, classes, penalty, bands, mean_energy, candidates, state
    )
    chosen = vectors[copy, y : y + height, x : x + width]
    taken = taken_pixels(window, chosen, bands)
    # The numbers of patches that touch differ by at most 1 in row and column.
    label = np.uint8(patch[0] % 16 * 16 + patch[1] % 16)
    for r in range(height):
        for c in range(width):
            if taken[r, c]:
                q, d = (top + r) % rows, (left + c) % columns
                labels[q, d] = label
                for k in range(3):
                    sheet[q, d, k] = chosen[r, c, k]
    return int(classes[copy, y, x])


@numba.njit(nogil=True, cache=True)
def _place_patches(
    first: int,
    last: int,
    sheet: Float32,
    labels: UInt8,
    patches: Int32,
    bands: Int32,
    size: int,
    vectors: Float32,
    slopes: Float32,
    starts: Int32,
    classes: Int32,
    penalty: Float64,
    mean_energy: float,
    candidates: int,
    seed: int,
    used: Int32,
) -> None:
    """Place patches that touch no common pixel, see `rig.in_threads`.

    Parameters
    ----------
    first, last
        Range of the patches to place.
    sheet, labels
        ``(H, W, 3)`` and ``(H, W)``, written.
    patches
        ``(n, 4)``: row and column in the grid, first row and column in the sheet. Windows that
        leave the sheet continue at its other side if they have a right or a bottom band.
    bands
        ``(n, 4)``: widths of the known parts of each window.
    size
        Side of a patch.
    vectors
        ``(copies, h, w, 3)`` normals of the exemplar and its copies.
    used
        ``(n,)``, written: classes of the places.

    For the others see `find_place`.
    """
    for i in range(first, last):
        known = (bands[i, 0], bands[i, 1], bands[i, 2], bands[i, 3])
        used[i] = _place(
            sheet, labels, patches[i], known, size, vectors, slopes, starts, classes, penalty,
            mean_energy, candidates, seed,
        )  # fmt: skip
