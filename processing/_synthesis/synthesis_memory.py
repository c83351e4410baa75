"""Memory of a synthesis of a sheet, at once and with the sheet in files."""

from __future__ import annotations

from processing._stages.stage import Need, Size
from processing._synthesis.strips import CORRECTED_ROWS, ROWS

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


def memory_need(exemplar: Size, size: Size, patch: int, overlap: int | None, copies: int) -> Need:
    """Return the memory of a synthesis.

    Parameters
    ----------
    exemplar, size
        (height, width) of exemplar and sheet.
    patch, overlap
        As for `synthesize`.
    copies
        Number of turned and mirrored copies of the exemplar.
    """
    height, width = size
    whole = _outside(exemplar, copies) + _figures(size) + _SHEET * height * width
    stride = patch - (patch // 4 if overlap is None else overlap)
    strip = min(ROWS * stride + patch, height) * _OF_STRIP
    band = min(CORRECTED_ROWS + _MARGIN, height) * _OF_BAND
    most = max(_figures(size), width * max(strip, band))
    least = _outside(exemplar, copies) + _ON_DISK * height * width + most
    return Need(whole, min(least, whole), f"a sheet of {width} x {height} pixels")


def _outside(exemplar: tuple[int, int], copies: int) -> int:
    """Return the bytes of what does not depend on the sheet."""
    return _FIXED + exemplar[0] * exemplar[1] * (_EXEMPLAR + _COPY * copies)


def _figures(size: tuple[int, int]) -> int:
    """Return the bytes that the figures of a sheet need."""
    return _FIGURES * min(size[0] * size[1], _MOST_FIGURES) // _MOST_FIGURES
