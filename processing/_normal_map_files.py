"""Normal maps on disk: images of normals and folders that contain them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from acquisition import (
    ComputedRows,
    DataError,
    MapRows,
    make_folder,
    missing_path,
    read_image_with_alpha,
    read_mask,
    write_exr,
    write_mask,
    write_png,
)
from processing._normal_map import NormalMap, check_normal_map
from processing._normal_pixels import clear, encode, lengths
from processing._npy_file import read_npy
from rig import MAX_PIXELS, Notice, Progress, in_threads, no_progress, pluralize, short_repr

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Pixels = npt.NDArray[Any]
Green = Literal["up", "down"]

# In order of preference: `write_normals` writes the same normals as EXR and as PNG.
_SUFFIXES = (".exr", ".npy", ".tif", ".tiff", ".png", ".jpg", ".jpeg")
_STEMS = ("normals", "normal_map")
# Decoded vectors differ from unit length by up to 0.3 in JPEG files. Black and white backgrounds
# decode to a length of 1.73, mid-grey ones to 0.
_LENGTH_TOLERANCE = 0.5
_BACKGROUND_LENGTH = 1.7
# An image is rejected unless most of its vectors are this close to unit length. One third of the
# pixels of a random image are, and 98 % of those of an 8-bit JPEG of normals.
_CLOSE = 0.1
# Vectors of a map of floats that decide how it is encoded.
_MOST_COMPARED = 1 << 18


class NormalMapFile(NamedTuple):
    """A normal map from a file, the warnings of its reader, and the files that were read."""

    normal_map: NormalMap
    warnings: tuple[Notice, ...]
    files: tuple[Path, ...]

    def __repr__(self) -> str:
        return short_repr(self)


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
        folder with ``normals.*`` or ``normal_map.*``. Integers encode ``n / 2 + 0.5``; floats are
        either encoded in the same way or are the vectors themselves. The reading whose vectors are
        closer to unit length is used.
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
        The map, normalised to unit length, and warnings about the use of alpha, 8-bit
        quantisation, vectors that are NaN or infinite (which are left out), pixels inside the mask
        without a normal, and normals that face away from the camera.

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
    (NormalMap(float32[4, 5, 3], 20 normals), ['normals-8-bit'])
    """
    file = _find_image(Path(path))
    pixels, alpha = _read_pixels(file, max_pixels)
    if pixels.ndim != 3 or pixels.shape[2] != 3:
        raise DataError(f"{file}: a normal map has three channels, this has shape {pixels.shape}")
    default = file.parent / "mask.png"
    mask_file = Path(mask_path) if mask_path is not None else default if default.exists() else None
    height, width = pixels.shape[:2]
    mask = None if mask_file is None else read_mask(mask_file, (height, width))
    eight_bits, finite = pixels.dtype == np.uint8, _finite(pixels)
    vectors, encoded = _decode(pixels)
    del pixels
    notes: list[Notice] = []
    if alpha is not None:
        share = _share(alpha)
        if encoded:
            _undo_premultiplication(vectors, share)
        if mask is None:
            mask, note = _mask_of_alpha(file, share)
            notes.append(note)
        elif not np.array_equal(mask, share > 0.5):
            text = f"the alpha channel is ignored, the mask is {mask_file}"
            notes.append(Notice("alpha-ignored", text, str(file), "info"))
    if green == "down":
        vectors[..., 1] *= -1
    length = np.zeros((height, width), np.float32)
    lengths(vectors, length)
    drawn = (length > _LENGTH_TOLERANCE) & (length < _BACKGROUND_LENGTH)
    off = np.abs(np.subtract(length, 1, out=length), out=length)
    unit, near = off < _LENGTH_TOLERANCE, off < _CLOSE
    # Alpha often includes background: some programs erase only pixels of the object.
    candidates = drawn if mask is None else mask if mask_file is not None else mask & drawn
    close = int(np.count_nonzero(candidates & near))
    count = int(np.count_nonzero(candidates))
    if 2 * close <= count:
        decoded = f"{close} of {count} pixels decode" if count else "no pixel decodes"
        raise DataError(
            f"{file}: {decoded} to a unit vector: this is not a normal map, or the mask belongs to "
            "another image"
        )
    normal_map = NormalMap.from_vectors(vectors, unit & candidates)
    read = (file,) if mask_file is None else (file, mask_file)
    if eight_bits:
        notes.append(_eight_bits(file))
    notes += _warnings(str(file), finite, normal_map, mask)
    return NormalMapFile(normal_map, tuple(notes), read)


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
    mask: Mask,
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
    >>> from acquisition import ComputedRows
    >>> from processing import write_normal_rows
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


def _encoded(normals: MapRows, mask: Mask, green: Green) -> MapRows:
    turned = -1.0 if green == "down" else 1.0

    def encoded(rows: slice) -> npt.NDArray[np.uint16]:
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
    for stem in _STEMS:
        for suffix in _SUFFIXES:
            file = path / f"{stem}{suffix}"
            if file.is_file():
                return file
    raise DataError(
        f"{path}: no normals in this folder: expected a file {' or '.join(_STEMS)} with one of the "
        f"suffixes {', '.join(_SUFFIXES)}"
    )


def _read_pixels(file: Path, max_pixels: int) -> tuple[Pixels, Pixels | None]:
    """Return the colours and the alpha channel, or None without alpha."""
    if file.suffix.lower() != ".npy":
        return read_image_with_alpha(file, max_pixels=max_pixels)
    array: Pixels = read_npy(file, 4 * max_pixels)
    if array.dtype not in (np.uint8, np.uint16) and not np.issubdtype(array.dtype, np.floating):
        raise DataError(f"{file}: numbers of type {array.dtype}, expected float, uint8 or uint16")
    if array.ndim == 3 and array.shape[2] == 4:
        return array[..., :3], array[..., 3]
    return array, None


def _finite(pixels: Pixels) -> Mask | None:
    """Return where all components are finite, or None for integers."""
    if pixels.dtype.kind != "f":
        return None
    x, y, z = (np.isfinite(pixels[..., k]) for k in range(3))
    finite: Mask = x & y & z
    return finite


def _share(alpha: Pixels) -> Float:
    full = float(np.iinfo(alpha.dtype).max) if np.issubdtype(alpha.dtype, np.integer) else 1.0
    share: Float = np.nan_to_num(alpha.astype(np.float32) / np.float32(full))
    return share


def _mask_of_alpha(file: Path, share: Float) -> tuple[Mask | None, Notice]:
    """Return the mask given by the alpha channel, and a note about it."""
    inside = share > 0.5
    if not inside.any():
        raise DataError(
            f"{file}: the alpha channel is below half everywhere: save the image without alpha, "
            "or put a mask.png into its folder"
        )
    if inside.all():
        text = "the alpha channel is opaque everywhere and is ignored"
        return None, Notice("alpha-opaque", text, str(file), "info")
    text = f"the alpha channel is the mask, {np.count_nonzero(inside)} of {inside.size} pixels"
    return inside, Notice("alpha-is-mask", text, str(file), "info")


def _undo_premultiplication(vectors: Float, share: Float) -> None:
    """Divide encoded colours by alpha if they are multiplied by it.

    Files do not state this reliably. Vectors that are stored without an encoding would only change
    their length.
    """
    partly = (share > 0) & (share < 1)
    stored = vectors[partly]
    divided = (stored + 1) / share[partly][:, None] - 1
    if _distance_to_unit(divided) < _distance_to_unit(stored):
        vectors[partly] = divided


def _decode(pixels: Pixels) -> tuple[Float, bool]:
    """Return the vectors, and whether they were encoded as ``n / 2 + 0.5``.

    An array of float32 is changed in place.
    """
    if np.issubdtype(pixels.dtype, np.integer):
        most = np.iinfo(pixels.dtype).max
        # A table, because the samples of an image in float64 take much memory.
        table = (np.arange(most + 1) * (2.0 / most) - 1.0).astype(np.float32)
        return table[pixels], True
    with np.errstate(over="ignore"):
        stored = np.ascontiguousarray(pixels, np.float32)
    # A pixel of zeros is background in either reading and must not influence the choice.
    drawn = np.zeros(pixels.shape[:2], np.bool_)
    clear(stored, drawn)
    count = int(np.count_nonzero(drawn))
    every = 1 + count // _MOST_COMPARED
    some = np.arange(0, count, every) if drawn.all() else np.flatnonzero(drawn)[::every]
    vectors = stored.reshape(-1, 3)[some]
    if _distance_to_unit(vectors) <= _distance_to_unit(vectors * 2 - 1):
        return stored, False
    return stored * 2 - 1, True


def _distance_to_unit(vectors: Float) -> float:
    with np.errstate(over="ignore"):
        length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return float(np.median(np.abs(length - 1))) if len(vectors) else 0.0


def _eight_bits(file: Path) -> Notice:
    cost = "0.4" if file.suffix.lower() in (".jpg", ".jpeg") else "0.2"
    text = f"8-bit normals are quantised, an error of about {cost} degree"
    return Notice("normals-8-bit", text, str(file))


def _warnings(
    where: str, finite: Mask | None, normal_map: NormalMap, mask: Mask | None
) -> list[Notice]:
    warnings = []
    not_finite = np.zeros(1, np.bool_) if finite is None else ~finite
    if finite is not None and mask is not None:
        not_finite &= mask
    if not_finite.any():
        words = (
            "pixel has a NaN or infinite vector and is",
            "pixels have a NaN or infinite vector and are",
        )
        text = f"{pluralize(int(not_finite.sum()), *words)} left out of the mask"
        warnings.append(Notice("normals-not-finite", text, where))
    lost = 0 if mask is None else np.count_nonzero(mask) - np.count_nonzero(normal_map.mask)
    if lost:
        words = (
            "pixel of the mask has no unit vector and is",
            "pixels of the mask have no unit vector and are",
        )
        text = f"{pluralize(int(lost), *words)} left out"
        warnings.append(Notice("normals-not-unit", text, where))
    if np.mean(normal_map.normals[..., 2][normal_map.mask]) < 0:
        text = "most normals face away from the camera: check the sign of z"
        warnings.append(Notice("normals-face-away", text, where))
    return warnings
