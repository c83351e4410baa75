"""Maps of results that are too large for the memory: read in bands of rows."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

import acquisition
import processing
from rig.arrays import AnyArray, Bool
from sgp.cli.options import Green
from sgp.report.folder import read_folder

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


def read_vectors(path: Path, max_pixels: int, green: Green = "up") -> tuple[Values, Bool]:
    """Return a map of normals, of a file or a folder, and its mask.

    A large one that a command wrote is read when its rows are asked for. All others are small, or
    have to be decoded and checked as a whole.

    Raises
    ------
    DataError, MissingPathError
        If there is no map, or it cannot be read.
    """
    file = path / "normals.exr" if path.is_dir() else path
    mask = file.parent / "mask.png"
    readable = file.suffix == ".exr" and file.is_file() and mask.exists()
    if readable and read_folder(file.parent).record_of(file) is not None:
        rows = acquisition.pixels.ImageRows(file, max_pixels=max_pixels)
        height, width = rows.shape[:2]
        if len(rows.shape) == 3 and height * width > LARGE:
            inside = acquisition.read_mask(mask, (height, width))
            read = partial(_vectors, rows)
            return acquisition.files.ComputedRows(rows.shape, rows.dtype, read), inside
        rows.close()
    found = processing.read_normals(path, green=green, max_pixels=max_pixels).normal_map
    return found.normals, found.mask


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
