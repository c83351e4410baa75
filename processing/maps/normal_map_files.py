"""Normal maps on disk: images of normals and folders that contain them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition import (
    DataError,
    MapRows,
    make_folder,
    missing_path,
    read_mask,
    write_exr,
    write_mask,
    write_png,
)
from acquisition.files import BandFile, ComputedRows
from acquisition.pixels import ImageRows, read_image_with_alpha
from processing.maps.normal_decoding import GivenMask, Green, PixelsInMemory, decode_normals, encode
from processing.maps.normal_map import NormalMap, check_normal_map
from processing.maps.npy_file import npy_shape, read_npy
from rig import MAX_PIXELS, Notice, Progress, in_threads, no_progress, short_repr
from rig.arrays import AnyArray, Bool, UInt16

# In order of preference: `write_normals` writes the same normals as EXR and as PNG.
_SUFFIXES = (".exr", ".npy", ".tif", ".tiff", ".png", ".jpg", ".jpeg")
_STEMS = ("normals", "normal_map")


class NormalMapFile(NamedTuple):
    """A normal map from a file, the warnings of its reader, and the files that were read."""

    normal_map: NormalMap
    warnings: tuple[Notice, ...]
    files: tuple[Path, ...]

    def __repr__(self) -> str:
        return short_repr(self)


class FoundNormals(NamedTuple):
    """A normal map on disk that was not decoded yet.

    Parameters
    ----------
    size
        (height, width), which the header of the file states.
    files
        Image, and mask if there is one.
    """

    size: tuple[int, int]
    files: tuple[Path, ...]


def find_normals(
    path: str | Path, *, mask_path: str | Path | None = None, max_pixels: int = MAX_PIXELS
) -> FoundNormals:
    """Return the files that `read_normals` would read, and the size of the map.

    Parameters, errors
        As for `read_normals`, except for damage after the header.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import write_png
    >>> from processing import find_normals
    >>> write_png("flat.png", np.full((4, 5, 3), (128, 128, 255), np.uint8))
    >>> find_normals("flat.png").size
    (4, 5)
    """
    file, mask_file = _files(Path(path), mask_path)
    if file.suffix.lower() == ".npy":
        shape = npy_shape(file)
    else:
        with ImageRows(file, max_pixels=max_pixels) as rows:
            shape = rows.shape
    if len(shape) != 3:
        raise _not_three(file, shape)
    return FoundNormals((shape[0], shape[1]), (file,) if mask_file is None else (file, mask_file))


def read_normals(
    path: str | Path,
    *,
    mask_path: str | Path | None = None,
    green: Green = "up",
    max_pixels: int = MAX_PIXELS,
) -> NormalMapFile:
    """Read a normal map from an image or a folder.

    Parameters
    ----------
    path
        An image (.exr, .npy, .tif, .png, .jpg) whose red, green and blue are x, y and z, or a
        folder with ``normals.*`` or ``normal_map.*``, also in its folder ``normals``. Integers
        encode ``n / 2 + 0.5``; floats are either encoded in the same way or are the vectors
        themselves. The reading whose vectors are closer to unit length is used. So are other
        encodings: 127 or 128 as the code of zero, a transfer curve, and maps of x and y only.
    mask_path
        An image that is brighter than half of its range inside the mask. Default: ``mask.png`` in
        the folder of the image if it exists, else the image's alpha, unless it is opaque
        everywhere. Without any mask, pixels that do not decode to a unit vector (black, white and
        mid-grey backgrounds) are outside.
    green
        ``down`` for maps whose green channel increases downwards (DirectX); the sign of y is then
        inverted.
    max_pixels
        Maximum number of pixels of the map. It is checked before anything is decoded.

    Returns
    -------
    NormalMapFile
        The map, normalised to unit length, and warnings about the use of alpha, the encoding, 8-bit
        quantisation, vectors that are NaN or infinite (which are left out), pixels inside the mask
        without a normal, normals that face away from the camera, and a z that is in the red or
        green channel.

    Raises
    ------
    MissingPathError
        If a path does not exist.
    DataError
        If a file cannot be read or has more than ``max_pixels``, the mask does not fit or is
        empty, or the image contains no normals.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import write_png
    >>> from processing import read_normals
    >>> write_png("flat.png", np.full((4, 5, 3), (128, 128, 255), np.uint8))
    >>> read = read_normals("flat.png")
    >>> read.normal_map, [notice.code for notice in read.warnings]
    (NormalMap(float32[4, 5, 3], 20 normals), ['normals-encoding', 'normals-8-bit'])
    """
    file, mask_file = _files(Path(path), mask_path)
    pixels = _read_pixels(file, max_pixels)
    given = _given_mask(file, pixels.shape, mask_file)
    samples = pixels.pixels
    # The memory of the image is used again.
    again = samples.dtype == np.float32 and samples.flags.c_contiguous
    normals = samples if again else np.zeros(samples.shape, np.float32)
    known, notices = decode_normals(file, pixels, given, green, normals)
    read = (file,) if given is None else (file, given.file)
    return NormalMapFile(NormalMap(normals, known), tuple(notices), read)


class StoredNormals(NamedTuple):
    """A normal map in a file.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors, 0 outside the mask. The caller closes the file.
    mask
        ``(H, W)`` bool, the pixels with a normal.
    warnings, files
        As in `NormalMapFile`.
    """

    normals: BandFile
    mask: Bool
    warnings: tuple[Notice, ...]
    files: tuple[Path, ...]

    def __repr__(self) -> str:
        return short_repr(self)


def store_normals(
    path: str | Path,
    file: Path,
    *,
    mask_path: str | Path | None = None,
    green: Green = "up",
    max_pixels: int = MAX_PIXELS,
) -> StoredNormals:
    """Read a normal map that is larger than memory into a file of unit vectors.

    Parameters
    ----------
    path, mask_path, green, max_pixels
        As for `read_normals`, as are the errors. Numbers of a .npy file are refused.
    file
        File of the vectors, of 12 bytes per pixel. An existing one is replaced.

    Returns
    -------
    StoredNormals
        The vectors and the mask of `read_normals`.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from acquisition import write_png
    >>> from processing.maps import store_normals
    >>> write_png("flat.png", np.full((4, 5, 3), (128, 128, 255), np.uint8))
    >>> stored = store_normals("flat.png", Path("flat.raw"))
    >>> stored.normals[1:3].shape, int(stored.mask.sum())
    ((2, 5, 3), 20)
    """
    image, mask_file = _files(Path(path), mask_path)
    if image.suffix.lower() == ".npy":
        raise DataError(
            f"{image}: a .npy file is read at once, and does not fit into memory: save it as .exr"
        )
    with ImageRows(image, max_pixels=max_pixels) as pixels:
        given = _given_mask(image, pixels.shape, mask_file)
        normals = BandFile(file, pixels.shape, np.dtype(np.float32))
        try:
            known, notices = decode_normals(image, pixels, given, green, normals)
            if not known.any():
                raise DataError(f"{image}: holds no normal: check its mask")
        except BaseException:
            normals.close()
            raise
    read = (image,) if given is None else (image, given.file)
    return StoredNormals(normals, known, tuple(notices), read)


def write_normals(
    folder: str | Path,
    normal_map: NormalMap,
    name: str = "normals",
    *,
    green: Green = "up",
    on_progress: Progress = no_progress,
) -> dict[str, Path]:
    """Write ``normals.exr`` (float), ``normals.png`` (16-bit) and ``mask.png`` into a folder.

    Parameters
    ----------
    folder
        Folder of the files, created if it is missing; files of these names are replaced.
    normal_map
        The map to write. The PNG contains ``round((n / 2 + 0.5) * 65535)`` and the mask as its
        alpha channel; outside the mask its colour is that of a normal toward the camera, in 8
        bits (128, 128, 255).
    name
        Stem of the files and of the output names.
    green
        ``down`` writes the PNG with a green channel that increases downwards (DirectX). The EXR
        always contains the vectors themselves.
    on_progress
        Receives the stage ``writing`` and the name, in tenths; the PNG takes most of the time.

    Returns
    -------
    dict[str, Path]
        Output name to path: ``normals``, ``normals_png``, ``mask``.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, write_normals
    >>> flat = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (4, 5, 1)))
    >>> [path.name for path in write_normals("flat", flat).values()]
    ['normals.exr', 'normals.png', 'mask.png']
    """
    check_normal_map("normal_map", normal_map)
    return write_normal_rows(
        folder, normal_map.normals, normal_map.mask, name, green=green, on_progress=on_progress
    )


def write_normal_rows(
    folder: str | Path,
    normals: MapRows,
    mask: Bool,
    name: str = "normals",
    *,
    green: Green = "up",
    on_progress: Progress = no_progress,
) -> dict[str, Path]:
    """Write the files of `write_normals` from normals whose rows are read band by band.

    Parameters
    ----------
    normals, mask
        As in `NormalMap`, but not checked; the normals may be on disk.
    folder, name, green, on_progress
        As in `write_normals`, as is the result.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition.files import ComputedRows
    >>> from processing.maps import write_normal_rows
    >>> up = np.float32([0, 0, 1])
    >>> flat = ComputedRows((4, 5, 3), up.dtype, lambda rows: np.tile(up, (4, 5, 1))[rows])
    >>> [path.name for path in write_normal_rows("flat", flat, np.ones((4, 5), bool)).values()]
    ['normals.exr', 'normals.png', 'mask.png']
    """
    folder = Path(folder)
    make_folder(folder)
    outputs = {
        name: folder / f"{name}.exr",
        f"{name}_png": folder / f"{name}.png",
        "mask": folder / "mask.png",
    }
    on_progress(f"writing {name}", 0, 10)
    # At the same time, because encoding and checking each keep one core busy.
    with ThreadPoolExecutor(1) as pool:
        exr = pool.submit(write_exr, outputs[name], normals)
        write_png(outputs[f"{name}_png"], _encoded(normals, mask, green), alpha=mask)
        on_progress(f"writing {name}", 8, 10)
        exr.result()
    on_progress(f"writing {name}", 9, 10)
    write_mask(outputs["mask"], mask)
    on_progress(f"writing {name}", 10, 10)
    return outputs


def _encoded(normals: MapRows, mask: Bool, green: Green) -> MapRows:
    turned = -1.0 if green == "down" else 1.0

    def encoded(rows: slice) -> UInt16:
        part = np.ascontiguousarray(normals[rows])
        samples = np.zeros(part.shape, np.uint16)
        in_threads(encode, len(samples), part, mask[rows], turned, samples)
        return samples

    return ComputedRows(normals.shape, np.dtype(np.uint16), encoded)


def _find_image(path: Path) -> Path:
    if not path.exists():
        raise missing_path(path)
    if not path.is_dir():
        return path
    names = [f"{stem}{suffix}" for stem in _STEMS for suffix in _SUFFIXES]
    # A result has them in a separate folder.
    for folder in (path, path / "normals"):
        for name in names:
            if (folder / name).is_file():
                return folder / name
    raise DataError(
        f"{path}: no normals in this folder: expected a file {' or '.join(_STEMS)} with one of the "
        f"suffixes {', '.join(_SUFFIXES)}"
    )


def _files(path: Path, mask_path: str | Path | None) -> tuple[Path, Path | None]:
    """Return the files of an image of normals and of its mask."""
    file = _find_image(path)
    default = file.parent / "mask.png"
    return file, Path(mask_path) if mask_path is not None else default if default.exists() else None


def _read_pixels(file: Path, max_pixels: int) -> PixelsInMemory:
    if file.suffix.lower() != ".npy":
        return PixelsInMemory(*read_image_with_alpha(file, max_pixels=max_pixels))
    array: AnyArray = read_npy(file, 4 * max_pixels)
    if array.dtype not in (np.uint8, np.uint16) and not np.issubdtype(array.dtype, np.floating):
        raise DataError(f"{file}: numbers of type {array.dtype}, expected float, uint8 or uint16")
    if array.ndim == 3 and array.shape[2] == 4:
        return PixelsInMemory(array[..., :3], array[..., 3])
    return PixelsInMemory(array, None)


def _given_mask(file: Path, shape: tuple[int, ...], mask_file: Path | None) -> GivenMask | None:
    if len(shape) != 3 or shape[2] != 3:
        raise _not_three(file, shape)
    return None if mask_file is None else GivenMask(read_mask(mask_file, shape[:2]), mask_file)


def _not_three(file: Path, shape: tuple[int, ...]) -> DataError:
    return DataError(f"{file}: a normal map has three channels, this has shape {shape}")
