"""Files of known heights: tables of points, and maps."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, Literal

import numpy as np

from acquisition import DataError, MissingPathError, read_image
from processing.maps.npy_file import read_npy
from processing.surface.prior import HeightPrior
from rig import MAX_PIXELS, UnreadableError, read_bounded
from rig.arrays import Floating

_MAPS: Final = (".exr", ".npy", ".tif", ".tiff")
_TABLES: Final = (".csv", ".txt")
_MOST_POINTS = 1_000_000
_SHOWN = 40


def read_prior(
    path: str | Path,
    size: tuple[int, int],
    *,
    unit: Literal["mm", "px"],
    sigma: float,
    max_pixels: int = MAX_PIXELS,
) -> HeightPrior:
    r"""Read known heights from a table of points or from a map.

    Parameters
    ----------
    path
        A table (.csv, .txt) whose first line names its columns, ``x_px,y_px,height_mm`` or
        ``x_px,y_px,height_px``, and optionally ``sigma_mm`` or ``sigma_px``: column and row of the
        normal map, where whole numbers are the centres of pixels, height and its standard
        deviation. In files with semicolons or tabs, commas are decimal commas. Or a map of floats
        with one channel (.exr, .npy, .tif) in ``unit``, of the size of the normal map or coarser,
        NaN where the height is not known.
    size
        Height and width of the normal map in pixels.
    unit
        Unit of the surface, see `surface_scale`.
    sigma
        Standard deviation of each point, or pixel of the map, in ``unit``; a column of the table
        replaces it.
    max_pixels
        Maximum number of pixels of a map.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is not such a table or map, its heights are in another unit than the surface,
        or it does not fit the normal map.

    Examples
    --------
    >>> from pathlib import Path
    >>> from processing.surface import read_prior
    >>> _ = Path("points.csv").write_text("x_px,y_px,height_mm\n3,1,0.25\n4,2,0.5\n")
    >>> read_prior("points.csv", (4, 6), unit="mm", sigma=0.01).count
    2
    """
    path = Path(path)
    suffix = path.suffix.lower()
    try:
        if suffix in _TABLES:
            return _points(_table(path), size, unit, sigma)
        if suffix not in _MAPS:
            raise DataError(
                f"a prior is a table ({', '.join(_TABLES)}) or a map of floats ({', '.join(_MAPS)})"
            )
        return HeightPrior.from_map(_map(path, max_pixels), sigma, size)
    except DataError as error:
        named = str(error).startswith(str(path))
        raise type(error)(f"{error}" if named else f"{path}: {error}") from error


def _map(path: Path, max_pixels: int) -> Floating:
    if path.suffix.lower() == ".npy":
        values = read_npy(path, max_pixels)
    else:
        values = read_image(path, max_pixels=max_pixels)
    if not np.issubdtype(values.dtype, np.floating):
        raise DataError(f"heights are floats with a unit, these are numbers of type {values.dtype}")
    return values


def _table(path: Path) -> list[tuple[int, list[str]]]:
    """Return the number and the fields of each line that is not blank."""
    try:
        data = read_bounded(path)
        text = data.decode("utf-8-sig")
    except FileNotFoundError as error:
        raise MissingPathError(f"{path}: no such file") from error
    except (UnreadableError, UnicodeDecodeError) as error:
        raise DataError(f"not a readable table: {error}") from error
    if re.search("[;\t]", text):  # commas are decimal commas
        text = text.replace(",", ".")
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    return [(number, re.split(r"\s*[,;\t]\s*|\s+", line)) for number, line in lines if line]


def _points(
    table: list[tuple[int, list[str]]],
    size: tuple[int, int],
    unit: Literal["mm", "px"],
    sigma: float,
) -> HeightPrior:
    names = [name.lower() for name in table[0][1]] if table else []
    other = "px" if unit == "mm" else "mm"
    if f"height_{other}" in names:
        raise DataError(
            f"the heights are in {other}, but those of the surface are in {unit}: "
            + ("convert them to mm" if unit == "mm" else "state the size of a pixel")
        )
    wanted = ["x_px", "y_px", f"height_{unit}"]
    if names not in (wanted, [*wanted, f"sigma_{unit}"]):
        raise DataError(
            f"the first line names the columns: {','.join(wanted)}, and optionally sigma_{unit}"
        )
    if len(table) > _MOST_POINTS:
        raise DataError(f"has more than {_MOST_POINTS} points: give a map")
    values = np.zeros((len(table) - 1, len(names)))
    for row, (number, fields) in zip(values, table[1:], strict=True):
        try:
            row[:] = [float(field) for field in fields]
        except ValueError:
            row[:] = np.nan
        if len(fields) != len(names) or not np.isfinite(row).all():
            shown = ",".join(fields)[:_SHOWN]
            raise DataError(f"line {number}: {shown} is not {len(names)} numbers")
    if not len(values):
        raise DataError("contains no point")
    sigmas = values[:, 3] if len(names) > len(wanted) else sigma
    return HeightPrior.from_points(values[:, :2], values[:, 2], sigmas, size)
