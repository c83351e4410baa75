"""Memory of a synthesis of a sheet, at once and with the sheet in files."""

from __future__ import annotations

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


def memory_of_synthesis(
    exemplar: tuple[int, int], size: tuple[int, int], *, copies: int = 1
) -> int:
    """Return the bytes that a program needs to read an exemplar and `synthesize` a sheet.

    Parameters
    ----------
    exemplar, size
        (height, width) of exemplar and sheet.
    copies
        Number of turned and mirrored copies of the exemplar.

    Examples
    --------
    >>> from processing import memory_of_synthesis
    >>> memory_of_synthesis((256, 256), (4000, 5000)) // 1_000_000 > 600
    True
    """
    return _outside(exemplar, copies) + _figures(size) + _SHEET * size[0] * size[1]


def least_memory_of_synthesis(
    exemplar: tuple[int, int],
    size: tuple[int, int],
    *,
    patch: int = 48,
    overlap: int | None = None,
    copies: int = 1,
) -> int:
    """Return the bytes that `synthesize_on_disk` needs.

    Parameters
    ----------
    exemplar, size, copies
        As for `memory_of_synthesis`.
    patch, overlap
        As for `synthesize`.

    Examples
    --------
    >>> from processing import least_memory_of_synthesis, memory_of_synthesis
    >>> sizes = (256, 256), (10000, 10000)
    >>> least_memory_of_synthesis(*sizes) < memory_of_synthesis(*sizes) / 2
    True
    """
    height, width = size
    stride = patch - (patch // 4 if overlap is None else overlap)
    strip = min(ROWS * stride + patch, height) * _OF_STRIP
    band = min(CORRECTED_ROWS + _MARGIN, height) * _OF_BAND
    most = max(_figures(size), width * max(strip, band))
    least = _outside(exemplar, copies) + _ON_DISK * height * width + most
    return min(least, memory_of_synthesis(exemplar, size, copies=copies))


def _outside(exemplar: tuple[int, int], copies: int) -> int:
    """Return the bytes of what does not depend on the sheet."""
    return _FIXED + exemplar[0] * exemplar[1] * (_EXEMPLAR + _COPY * copies)


def _figures(size: tuple[int, int]) -> int:
    """Return the bytes that the figures of a sheet need."""
    return _FIGURES * min(size[0] * size[1], _MOST_FIGURES) // _MOST_FIGURES
