"""Surfaces in files of ISO 25178-72 (.x3p), as programs for surface texture read them.

The file states lengths in metres and its first row is the lowest one. Heights are written as
64-bit floats, which is exact: a 32-bit number of millimetres, divided by 1000, is the nearest one
again after multiplication. The revision is the first one, "ISO5436 - 2000", which all readers know.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from acquisition import DataError, write_durably
from acquisition.files import SOFTWARE, software_version
from processing.maps.npy_file import readable
from rig import MAX_PIXELS, UnreadableError, read_bounded, short_repr
from rig.arrays import Float32
from rig.files import MAX_BINARY_BYTES, MAX_TEXT_BYTES, check_pixels, convert_parser_errors
from rig.host import clock

if TYPE_CHECKING:
    import x3pio

_MM_PER_M: Final = 1000.0
_BYTES: Final = {"I": 2, "L": 4, "F": 4, "D": 8}
# An optical instrument sees less; a file in mm or um instead of metres states more.
_WIDEST_MM: Final = 10_000.0
_SQUARE: Final = 1e-6
_CHECKSUM: Final = re.compile(rb"MD5ChecksumPointData>\s*[0-9a-fA-F]{32}\s*<")
_LONGEST_COMMENT: Final = 10_000


@dataclass(frozen=True)
class X3pOrigin:
    """What an X3P file states about its origin; empty if it is not known.

    Parameters
    ----------
    date
        When the data were measured, with a time zone. A file that `write_x3p` writes has it as the
        date of a calibration, too, which the standard requires.
    creator
        Person or institution.
    manufacturer, model, serial, version
        Instrument or software.
    probing
        Kind of the probing system; ``software`` for data that were not measured.
    method
        Description of the probing system.
    comment
        Free text.
    """

    date: datetime | None = None
    creator: str = ""
    manufacturer: str = SOFTWARE
    model: str = SOFTWARE
    serial: str = ""
    version: str = ""
    probing: Literal["non-contacting", "contacting", "software", ""] = "non-contacting"
    method: str = "photometric stereo, heights integrated from normals"
    comment: str = ""


@dataclass(frozen=True, eq=False)
class X3pSurface:
    """A surface from an X3P file.

    Parameters
    ----------
    height
        ``(H, W)`` float32 in mm along +Z, the first row is the upper one; NaN where not measured.
    pixel_mm
        Distance between neighbouring points.
    origin
        What the file states about its origin.
    """

    height: Float32
    pixel_mm: float
    origin: X3pOrigin

    __repr__ = short_repr


def write_x3p(
    path: str | Path, height: Float32, pixel_mm: float, *, origin: X3pOrigin | None = None
) -> None:
    """Write heights as an X3P file; equal arguments with a date give equal bytes.

    Parameters
    ----------
    path
        The file (.x3p). An existing file is replaced.
    height
        ``(H, W)`` float32 in mm along +Z, the first row is the upper one; NaN where not measured.
        `read_x3p` returns the same values.
    pixel_mm
        Distance between neighbouring points in mm.
    origin
        What the file states about its origin. Without a date, it states the present time; without a
        version, that of this program.

    Raises
    ------
    DataError
        If the heights are not such an array, one is infinite, all are NaN, or a text contains a
        character that XML cannot hold.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.surface import read_x3p, write_x3p
    >>> write_x3p("step.x3p", np.array([[0.5, np.nan], [0, 0.25]], np.float32), pixel_mm=0.05)
    >>> read_x3p("step.x3p").height.tolist()
    [[0.5, nan], [0.0, 0.25]]
    """
    import x3pio

    path, origin = Path(path), origin or X3pOrigin()
    if path.suffix.lower() != ".x3p":
        raise DataError(f"{path}: the suffix must be .x3p")
    if height.ndim != 2 or height.dtype != np.float32 or np.isinf(height).any():
        raise DataError(f"{path}: heights are a float32 array (H, W) in mm without infinity")
    if np.isnan(height).all():
        raise DataError(f"{path}: there is no height: all are NaN")
    if not (math.isfinite(pixel_mm) and pixel_mm > 0):
        raise DataError(f"{path}: the size of a pixel must be more than 0 mm: {pixel_mm}")
    metadata = x3pio.Metadata(
        date=origin.date or clock.utc_now(),
        creator=origin.creator or None,
        instrument=x3pio.Instrument(
            origin.manufacturer, origin.model, origin.serial, origin.version or software_version()
        ),
        probing_system=x3pio.ProbingSystem(
            x3pio.ProbingType[(origin.probing or "software").upper().replace("-", "_")],
            origin.method,
        ),
        comment=origin.comment or None,
    )
    buffer = io.BytesIO()
    try:
        x3pio.write(
            buffer,
            np.flipud(height).astype(np.float64) / _MM_PER_M,
            x_scale=pixel_mm / _MM_PER_M,
            y_scale=pixel_mm / _MM_PER_M,
            metadata=metadata,
            revision=x3pio.Revision.ISO5436_2000,
        )
    except x3pio.X3pError as error:
        raise DataError(f"{path}: {error}") from error
    write_durably(path, buffer.getvalue())


def read_x3p(path: str | Path, *, max_pixels: int = MAX_PIXELS) -> X3pSurface:
    """Read the surface of an X3P file: one layer on a grid of squares.

    The offset of z is added to the heights; the place of the grid in x and y is not kept.

    Parameters
    ----------
    path
        The file, with heights as integers or floats.
    max_pixels
        Maximum number of points.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is not X3P, is damaged or has no checksum of its heights, or contains something
        else: a profile, points without a grid, several layers, a rotated grid, or lengths that
        cannot be metres.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.surface import read_x3p, write_x3p
    >>> write_x3p("plane.x3p", np.zeros((4, 6), np.float32), pixel_mm=0.5)
    >>> read_x3p("plane.x3p").pixel_mm
    0.5
    """
    with readable(Path(path), "X3P file"):
        data = read_bounded(Path(path), MAX_BINARY_BYTES)
        spacing = _checked(data, max_pixels)
        import x3pio

        with np.errstate(over="ignore", invalid="ignore"):
            with convert_parser_errors("is not X3P", x3pio.X3pError, zipfile.BadZipFile):
                file = x3pio.read(io.BytesIO(data))
            metres = file.layers[0].z + float(file.placement.offset[2])
            height = (np.flipud(metres) * _MM_PER_M).astype(np.float32)
        if np.isinf(height).any():
            raise UnreadableError("heights of more than 1e38 mm: it is damaged")
        return X3pSurface(height, spacing, _origin(file.metadata))


def _checked(data: bytes, max_pixels: int) -> float:
    """Check what a file states before its heights are read; return the distance of its points."""
    import x3pio

    with convert_parser_errors("is not X3P", x3pio.X3pError, zipfile.BadZipFile):
        members = zipfile.ZipFile(io.BytesIO(data)).infolist()
        mains = [one for one in members if one.filename.endswith("main.xml")]
        if any(one.file_size > MAX_TEXT_BYTES for one in mains):
            raise UnreadableError(f"main.xml has more than {MAX_TEXT_BYTES >> 20} MB")
        info = x3pio.info(io.BytesIO(data), verify=False)
        main = zipfile.ZipFile(io.BytesIO(data)).read(min(mains, key=lambda one: len(one.filename)))
    if info.feature_type is not x3pio.FeatureType.SURFACE or info.layer_count != 1:
        kind = info.feature_type.name.lower().replace("_", " ")
        layers = f" of {info.layer_count} layers" if info.layer_count != 1 else ""
        raise UnreadableError(f"contains a {kind}{layers}, not a surface of one layer")
    rows, columns = info.shape
    x, y = info.header.x, info.header.y
    if not (x.is_incremental and y.is_incremental) or info.placement.has_rotation:
        raise UnreadableError("its points are not on an upright grid: resample them")
    steps = [x.increment * _MM_PER_M, y.increment * _MM_PER_M]
    if min(steps) <= 0 or not math.isclose(*steps, rel_tol=_SQUARE):
        raise UnreadableError(f"pixels of {steps[0]:g} x {steps[1]:g} mm: resample to squares")
    if max(rows, columns) * steps[0] > _WIDEST_MM:
        raise UnreadableError(
            f"states {columns * steps[0] / 1e3:g} x {rows * steps[0] / 1e3:g} m: lengths of X3P "
            "are in metres; was it written in another unit?"
        )
    bytes_of_point = _BYTES[info.header.z.data_type.value]
    check_pixels(columns, rows, 8 * bytes_of_point, len(data), max_pixels)
    most = max(MAX_TEXT_BYTES, rows * columns * bytes_of_point)
    if any(one.file_size > most for one in members):
        raise UnreadableError("contains a file that is larger than its heights")
    if info.storage is x3pio.DataStorage.BINARY and not _CHECKSUM.search(main):
        raise UnreadableError(
            "states no MD5 checksum of its heights, which the standard requires: save it again in "
            "the program that wrote it"
        )
    # Without the rounding error of the division by 1000.
    return float(f"{steps[0]:.15g}")


def _origin(found: x3pio.Metadata | None) -> X3pOrigin:
    if found is None:
        return X3pOrigin(manufacturer="", model="", probing="", method="")
    kinds: dict[str, Literal["non-contacting", "contacting", "software"]] = {
        "NON_CONTACTING": "non-contacting",
        "CONTACTING": "contacting",
        "SOFTWARE": "software",
    }
    kind = found.probing_system.type
    return X3pOrigin(
        date=found.date,
        creator=found.creator or "",
        manufacturer=found.instrument.manufacturer,
        model=found.instrument.model,
        serial=found.instrument.serial,
        version=found.instrument.version,
        probing="" if kind is None else kinds[kind.name],
        method=found.probing_system.identification,
        comment=(found.comment or "")[:_LONGEST_COMMENT],
    )
