"""Memory of a transfer of detail, at once and in bands of rows."""

from __future__ import annotations

from dataclasses import dataclass

from processing._detail import rows
from processing._detail.shape_filter import ShapeFilter

# Rows of a map that the similarity of a row needs above and below.
AROUND = 5
# Bytes per pixel of a band, besides those of its separation: the placed detail, its labels, the
# shapes, the errors and what the similarities need.
_OF_BAND = 110
# Bytes per pixel if both maps are in memory, besides those of the separation: of the target while
# its errors are measured, of the source meanwhile and while it is separated, of a map that waits.
_TARGET, _SOURCE, _SEPARATED, _WAITING = 105, 25, 15, 13
# Bytes per pixel: of masks while the maps are on disk, and while the second map is read.
_MASKS, _READING = 4, 6


@dataclass(frozen=True)
class TransferSizes:
    """What the memory of a transfer depends on.

    Parameters
    ----------
    source, target
        (height, width) of the maps.
    shape_filter
        The filter that separates them.
    refine
        Number of corrections.
    """

    source: tuple[int, int]
    target: tuple[int, int]
    shape_filter: ShapeFilter = ShapeFilter()
    refine: int = 0

    @property
    def halo(self) -> int:
        """Rows above and below a band that it reads."""
        return rows.halo_rows(self.shape_filter) + AROUND

    def whole(self) -> int:
        """Return the bytes of a program that reads both maps and calls `transfer`."""
        source, target = (height * width for height, width in (self.source, self.target))
        filtered = rows.pixel_bytes(self.shape_filter)
        return rows.fixed() + max(
            source * (_SEPARATED + filtered) + target * _WAITING,
            source * _SOURCE + target * (_TARGET + filtered),
        )

    def least(self) -> int:
        """Return the bytes of a transfer in bands, at least."""
        around = min(2 * self.halo, self._height()) * self._filtered()
        band = around + min(rows.LEAST_ROWS, self._height()) * self._row()
        return min(self._outside() + band, self.whole())

    def band_rows(self, memory: int) -> int:
        """Return the rows of a band for which a number of bytes is enough."""
        free = memory - self._outside() - 2 * self.halo * self._filtered()
        return rows.useful_rows(free // self._row(), self.halo)

    def spare(self, memory: int) -> int:
        """Return the bytes that are left for a part of the source before the first band."""
        return memory - self._outside()

    def _outside(self) -> int:
        """Return the bytes besides a band."""
        source, target = (height * width for height, width in (self.source, self.target))
        held = _MASKS * target + source
        return rows.fixed() + max(_READING * source, _READING * target + source, held)

    def _filtered(self) -> int:
        """Return the bytes of a row that is only filtered."""
        return max(self.source[1], self.target[1]) * rows.pixel_bytes(self.shape_filter)

    def _row(self) -> int:
        """Return the bytes of a row of a band."""
        return self._filtered() + max(self.source[1], self.target[1]) * _OF_BAND

    def _height(self) -> int:
        return max(self.source[0], self.target[0])
