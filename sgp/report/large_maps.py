"""Maps of results that are too large for the memory: read in bands of rows."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

import acquisition
from rig.arrays import AnyArray, Bool
from sgp.report.folder import ResultFolder

Values = AnyArray | acquisition.MapRows

LARGE: Final = 20_000_000  # pixels; smaller maps are read as a whole
_BAND: Final = 256  # rows


def read_map(path: Path, max_pixels: int) -> Values:
    """Return a map; a large one is read when its rows are asked for.

    Raises
    ------
    DataError
        If the file cannot be read; of a large one, its later rows are checked when they are read.
    """
    rows = acquisition.pixels.ImageRows(path, max_pixels=max_pixels)
    if rows.shape[0] * rows.shape[1] > LARGE:
        return rows
    rows.close()
    return acquisition.read_image(path, max_pixels=max_pixels)


def large_normals(
    folder: ResultFolder, path: Path, max_pixels: int
) -> tuple[acquisition.MapRows, Bool] | None:
    """Return a large map of normals that a command wrote, and its mask.

    None for all others: they are small, or have to be decoded and checked as a whole.
    """
    mask = path.parent / "mask.png"
    if path.suffix != ".exr" or folder.record_of(path) is None or not mask.exists():
        return None
    rows = acquisition.pixels.ImageRows(path, max_pixels=max_pixels)
    height, width = rows.shape[:2]
    if len(rows.shape) != 3 or height * width <= LARGE:
        rows.close()
        return None
    inside = acquisition.read_mask(mask, (height, width))
    return acquisition.files.ComputedRows(rows.shape, rows.dtype, partial(_vectors, rows)), inside


def _vectors(rows: acquisition.pixels.ImageRows, band: slice) -> AnyArray:
    """Return rows of vectors; those of length 0 are NaN."""
    vectors = rows[band]
    vectors[~vectors.any(axis=2)] = np.nan
    return vectors


def known(values: Values) -> Bool:
    """Return which pixels of a map have a value."""
    bands = (np.isfinite(values[top : top + _BAND]) for top in range(0, values.shape[0], _BAND))
    found = np.concatenate([one if one.ndim == 2 else one.any(axis=2) for one in bands])
    return found.astype(np.bool_, copy=False)
