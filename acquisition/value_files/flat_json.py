"""flat.json: a flat field, with its two parts as images next to it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from acquisition._errors import DataError, named
from acquisition.files.storage import make_folder, write_durably
from acquisition.files.text_files import parse_versioned, read_text
from acquisition.pixels.images import read_image, write_exr
from acquisition.session.value_records import CalibratedRecord, Table
from acquisition.values.flat import Flat
from rig import MAX_PIXELS, check_type
from rig.arrays import Float32

FLAT_FILE: Final = "flat.json"
_PARTS: Final = ("smooth", "pixel")
_Deviation = Annotated[float, Field(ge=0)]


class _Image(Table):
    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+\.exr$")]
    pixels_sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class _FlatFile(Table):
    format: Literal["sgp-flat"] = "sgp-flat"
    version: Literal[1] = 1
    smooth: _Image
    pixel: _Image
    cfa: Literal["RGGB", "GRBG", "GBRG", "BGGR"] | None = None
    pixel_std: _Deviation | None = None
    gradient_std: _Deviation | None = None
    covered: Annotated[float, Field(ge=0, le=1)] = 1.0
    calibrated: CalibratedRecord = CalibratedRecord()
    outputs: Annotated[dict[str, str], Field(default_factory=dict)]
    provenance: Annotated[dict[str, Any], Field(default_factory=dict)]


def flat_files(path: str | Path) -> list[Path]:
    """Return the files of a flat that exist, for hashing: flat.json and its images.

    Parameters
    ----------
    path
        As in `read_flat`.

    Examples
    --------
    >>> from acquisition.value_files import flat_files
    >>> flat_files("nowhere")
    []
    """
    path = _file_of(Path(path))
    files = [path, *(path.with_name(f"{part}.exr") for part in _PARTS)]
    return [file for file in files if file.is_file()]


def read_flat(path: str | Path, *, max_pixels: int = MAX_PIXELS) -> Flat:
    """Read a flat field.

    Parameters
    ----------
    path
        flat.json, or its folder.
    max_pixels
        Largest allowed number of pixels, checked before the images are decoded.

    Raises
    ------
    MissingPathError
        If a file does not exist.
    DataError
        If flat.json is invalid or has another version, an image is damaged or not the one that
        flat.json names, or a value is not a number; the message names the file.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Flat
    >>> from acquisition.value_files import read_flat, write_flat
    >>> ones = np.ones((4, 6), np.float32)
    >>> write_flat("flat", Flat(ones, ones))
    >>> read_flat("flat/flat.json")
    Flat(6 x 4 px, corners 100.0%)
    """
    path = _file_of(Path(path))
    text = read_text(path)
    file = parse_versioned(_FlatFile, text, path, lambda version: str(version)[:20])
    smooth, pixel = (
        _read_part(path.with_name(part.file), part.pixels_sha256, max_pixels)
        for part in (file.smooth, file.pixel)
    )
    with named(path):
        return Flat(
            smooth,
            pixel,
            **file.model_dump(include={"cfa", "pixel_std", "gradient_std", "covered"}),
            calibrated=file.calibrated.value(),
        )


def write_flat(
    folder: str | Path,
    flat: Flat,
    *,
    outputs: dict[str, str] | None = None,
    provenance: dict[str, Any] | None = None,
) -> None:
    """Write a flat field as smooth.exr, pixel.exr and, last, flat.json.

    Parameters
    ----------
    folder
        Folder to write to; it is created if it does not exist.
    flat
        The flat.
    outputs
        Names of other files that were written with it.
    provenance
        Origin of the flat: names with finite values that JSON can hold.

    Raises
    ------
    StorageError
        If a file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from acquisition import Flat
    >>> from acquisition.value_files import write_flat
    >>> ones = np.ones((4, 6), np.float32)
    >>> write_flat("flat", Flat(ones, ones))
    >>> sorted(path.name for path in Path("flat").iterdir())
    ['flat.json', 'pixel.exr', 'smooth.exr']
    """
    check_type("flat", flat, Flat, "read_flat(path) returns one")
    folder = Path(folder)
    make_folder(folder)
    for part in _PARTS:
        write_exr(folder / f"{part}.exr", getattr(flat, part))
    # Times and identities only: a flat has no spheres.
    record = _FlatFile(
        smooth=_Image(file="smooth.exr", pixels_sha256=_sha256(flat.smooth)),
        pixel=_Image(file="pixel.exr", pixels_sha256=_sha256(flat.pixel)),
        cfa=flat.cfa,  # type: ignore[arg-type]  # pydantic checks it
        pixel_std=flat.pixel_std,
        gradient_std=flat.gradient_std,
        covered=flat.covered,
        calibrated=CalibratedRecord.of(replace(flat.calibrated, spheres=())),
        outputs={"smooth": "smooth.exr", "pixel": "pixel.exr", **(outputs or {})},
        provenance=provenance or {},
    )
    text = json.dumps(record.model_dump(mode="json", exclude_none=True), indent=1, allow_nan=False)
    write_durably(folder / FLAT_FILE, f"{text}\n".encode())


def _file_of(path: Path) -> Path:
    return path / FLAT_FILE if path.is_dir() else path


def _read_part(path: Path, sha256: str, max_pixels: int) -> Float32:
    values = read_image(path, max_pixels=max_pixels)
    if values.dtype != np.float32:
        raise DataError(f"{path}: has {values.dtype} samples, a flat has float32: calibrate again")
    image = values.astype(np.float32, copy=False)
    if _sha256(image) != sha256:
        raise DataError(
            f"{path}: its pixels differ from those that {FLAT_FILE} names: restore the file, or "
            "calibrate the flat again"
        )
    return image


def _sha256(values: Float32) -> str:
    return hashlib.sha256(np.ascontiguousarray(values, "<f4").data.cast("B")).hexdigest()
