"""Sheets of patches in strips of rows, so that only a part of a large sheet is in memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from acquisition import MapRows
from rig.arrays import Float32, Int32

# Rows of patches of a strip: as many threads can place patches of one diagonal.
ROWS = 16
# Rows of a sheet that are corrected at once.
CORRECTED_ROWS = 512


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


def bands_with_margins(
    sheet: MapRows, reach: int, *, wrapped: bool, begin: int = 0
) -> Iterator[tuple[slice, Float32]]:
    """Yield bands of rows, with the rows above and below that a correction needs.

    The sheet may be replaced band by band with what is computed of them.

    Parameters
    ----------
    sheet
        The sheet to correct.
    reach
        Number of rows above and below.
    wrapped
        Whether the last row continues at the first; otherwise the sheet continues with its
        reflection.
    begin
        The first band; if it is not 0, the sheet is not replaced.
    """
    height = sheet.shape[0]
    # Copies of rows that are replaced before they are read.
    upper, lower = sheet[: reach + 1].copy(), sheet[max(height - reach - 1, 0) : height].copy()
    above = lower[1:] if wrapped else upper[:0:-1]
    beyond = upper[:-1] if wrapped else lower[-2::-1]
    if not len(above):  # a sheet of one row
        above = beyond = upper
    first = begin * CORRECTED_ROWS
    if begin:
        above = sheet[first - reach : first]
    for top in range(first, height, CORRECTED_ROWS):
        last = min(top + CORRECTED_ROWS, height)
        below = np.concatenate([sheet[last : min(last + reach, height)], beyond])[:reach]
        band = np.concatenate([above, sheet[top:last], below])
        above = band[len(band) - 2 * reach : len(band) - reach].copy()
        yield slice(top, last), band
