"""Normal maps on disk: images of normals, and folders of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from acquisition import (
    DataError,
    MissingPathError,
    read_image_with_alpha,
    read_mask,
    write_exr,
    write_png,
)
from processing._normal_map import NormalMap
from processing._npy_file import read_npy
from rig import MAX_PIXELS

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Pixels = npt.NDArray[Any]

# The best first: what `write_normals` makes holds the same normals as EXR and as PNG.
_SUFFIXES = (".exr", ".npy", ".tif", ".tiff", ".png", ".jpg", ".jpeg")
_STEMS = ("normals", "normal_map")
# Decoded vectors differ from unit length by up to 0.3 in JPEG files. Black and white backgrounds
# decode to a length of 1.73, mid-grey ones to 0.
_LENGTH_TOLERANCE = 0.5
_BACKGROUND_LENGTH = 1.7
# A picture is something else unless most of its vectors are this close to unit length: of random
# colours a third are, of an 8-bit JPEG of normals 98 %.
_CLOSE = 0.1
_LONGEST = 1000.0


class NormalMapFile(NamedTuple):
    """What a file of normals held: the map, what its reader has to say, and the files it read."""

    normal_map: NormalMap
    warnings: tuple[str, ...]
    files: tuple[Path, ...]


def read_normals(
    path: str | Path,
    *,
    mask_path: str | Path | None = None,
    green: Literal["up", "down"] = "up",
    max_pixels: int = MAX_PIXELS,
) -> NormalMapFile:
    """Read a normal map from an image or a folder.

    Parameters
    ----------
    path
        An image (.exr, .npy, .tif, .png, .jpg) whose red, green and blue are x, y and z, or a
        folder with ``normals.*`` or ``normal_map.*``. Integers encode ``n / 2 + 0.5``; floats hold
        either that or the vectors themselves, whichever are closer to unit length.
    mask_path
        An image that is brighter than half of its range inside. Default: ``mask.png`` beside the
        image where there is one, else the image's alpha, unless it is opaque everywhere. With no
        mask at all, pixels that do not decode to a unit vector (black, white and mid-grey
        backgrounds) are outside.
    green
        ``down`` for maps whose green grows downwards (DirectX); y is then turned round.
    max_pixels
        The most that the map may have. It is checked before anything is decoded.

    Returns
    -------
    NormalMapFile
        The map, brought to unit length, and warnings: what became of alpha, 8-bit quantisation,
        vectors that are NaN or infinite, which are left out, pixels inside the mask without a
        normal, normals that face away.

    Raises
    ------
    MissingPathError
        If a path does not exist.
    DataError
        If a file is not understood, has more than ``max_pixels``, the mask does not fit or is
        empty, or the image holds no normals.
    """
    file = _find_image(Path(path))
    pixels, alpha = _read_pixels(file, max_pixels)
    if pixels.ndim != 3 or pixels.shape[2] != 3:
        raise DataError(f"{file}: a normal map has three channels, this is of shape {pixels.shape}")
    beside = file.parent / "mask.png"
    mask_file = Path(mask_path) if mask_path is not None else beside if beside.exists() else None
    height, width = pixels.shape[:2]
    mask = None if mask_file is None else read_mask(mask_file, (height, width))
    vectors, encoded = _decode(pixels)
    notes: list[str] = []
    if alpha is not None:
        share = _share(alpha)
        if encoded:
            _undo_premultiplication(vectors, share)
        if mask_file is None:
            mask, note = _mask_of_alpha(file, share)
        else:
            note = f"{file}: its alpha channel is ignored, the mask is {mask_file}"
        notes.append(note)
    if green == "down":
        vectors[..., 1] *= -1
    length = np.sqrt(np.einsum("ijk,ijk->ij", vectors, vectors))
    unit = np.abs(length - 1) < _LENGTH_TOLERANCE
    drawn = (length > _LENGTH_TOLERANCE) & (length < _BACKGROUND_LENGTH)
    # Alpha often leaves a background inside, where only an object's own pixels were erased.
    candidates = drawn if mask is None else mask if mask_file is not None else mask & drawn
    close = int(np.count_nonzero(candidates & (np.abs(length - 1) < _CLOSE)))
    count = int(np.count_nonzero(candidates))
    if 2 * close <= count:
        decoded = f"{close} of {count} pixels decode" if count else "no pixel decodes"
        raise DataError(
            f"{file}: {decoded} to a unit vector: this is not a normal map, or its mask is "
            "another's"
        )
    normal_map = NormalMap.from_vectors(vectors, unit & candidates)
    read = (file,) if mask_file is None else (file, mask_file)
    notes += _warnings(file, pixels, normal_map, mask)
    return NormalMapFile(normal_map, tuple(notes), read)


def write_normals(
    folder: str | Path, normal_map: NormalMap, name: str = "normals"
) -> dict[str, Path]:
    """Write ``normals.exr`` (float), ``normals.png`` (16-bit) and ``mask.png`` into a folder.

    Parameters
    ----------
    folder
        An existing folder; files of these names are replaced.
    normal_map
        What to write. The PNG holds ``round((n / 2 + 0.5) * 65535)``, mid-grey outside the mask;
        green is up.
    name
        Another stem than ``normals`` for the files and in the output names.

    Returns
    -------
    dict[str, Path]
        Output name to path: ``normals``, ``normals_png``, ``mask``.
    """
    folder = Path(folder)
    outputs = {
        name: folder / f"{name}.exr",
        f"{name}_png": folder / f"{name}.png",
        "mask": folder / "mask.png",
    }
    encoded = np.rint((normal_map.normals.astype(np.float64) * 0.5 + 0.5) * 65535)
    write_exr(outputs[name], normal_map.normals)
    write_png(outputs[f"{name}_png"], encoded.astype(np.uint16))
    write_png(outputs["mask"], normal_map.mask.astype(np.uint8) * 255)
    return outputs


def _find_image(path: Path) -> Path:
    if not path.exists():
        raise MissingPathError(f"{path}: no such file or folder")
    if not path.is_dir():
        return path
    for stem in _STEMS:
        for suffix in _SUFFIXES:
            file = path / f"{stem}{suffix}"
            if file.is_file():
                return file
    raise DataError(
        f"{path}: no normals in this folder, expected one of {', '.join(_STEMS)} with a suffix of "
        f"{', '.join(_SUFFIXES)}"
    )


def _read_pixels(file: Path, max_pixels: int) -> tuple[Pixels, Pixels | None]:
    """Return colours and alpha."""
    if file.suffix.lower() != ".npy":
        return read_image_with_alpha(file, max_pixels=max_pixels)
    array: Pixels = read_npy(file, 4 * max_pixels)
    if array.dtype not in (np.uint8, np.uint16) and not np.issubdtype(array.dtype, np.floating):
        raise DataError(f"{file}: numbers of type {array.dtype}, expected float, uint8 or uint16")
    if array.ndim == 3 and array.shape[2] == 4:
        return array[..., :3], array[..., 3]
    return array, None


def _not_finite(pixels: Pixels) -> Mask:
    if pixels.dtype.kind != "f":
        return np.zeros(pixels.shape[:2], np.bool_)
    return np.asarray(~np.isfinite(pixels).all(axis=2), np.bool_)


def _share(alpha: Pixels) -> Float:
    full = float(np.iinfo(alpha.dtype).max) if np.issubdtype(alpha.dtype, np.integer) else 1.0
    share: Float = np.nan_to_num(alpha.astype(np.float32) / np.float32(full))
    return share


def _mask_of_alpha(file: Path, share: Float) -> tuple[Mask | None, str]:
    """Return the mask that alpha draws, and what to say about it."""
    inside = share > 0.5
    if not inside.any():
        raise DataError(
            f"{file}: its alpha channel leaves nothing inside: save it without alpha, or put a "
            "mask.png beside it"
        )
    if inside.all():
        return None, f"{file}: its alpha channel is opaque everywhere and is ignored"
    count = np.count_nonzero(inside)
    return inside, f"{file}: its alpha channel is the mask, {count} of {inside.size} pixels"


def _undo_premultiplication(vectors: Float, share: Float) -> None:
    """Divide encoded colours by alpha if they are multiplied by it: files do not tell reliably.

    Vectors that are stored as they are only change their length.
    """
    partly = (share > 0) & (share < 1)
    stored = vectors[partly]
    divided = (stored + 1) / share[partly][:, None] - 1
    if _distance_to_unit(divided) < _distance_to_unit(stored):
        vectors[partly] = divided


def _decode(pixels: Pixels) -> tuple[Float, bool]:
    """Return vectors, and whether they were encoded as ``n / 2 + 0.5``."""
    if np.issubdtype(pixels.dtype, np.integer):
        scale = 2.0 / float(np.iinfo(pixels.dtype).max)
        return (pixels * scale - 1.0).astype(np.float32), True
    # No vector of unit length is so long, and the square of a longer one would overflow.
    usable = (np.abs(pixels) < _LONGEST).all(axis=2, keepdims=True)
    stored = np.where(usable, pixels, 0).astype(np.float32)
    encoded = stored * 2 - 1
    # A pixel of zeros is background in either reading and must not vote.
    drawn = stored.any(axis=2)
    if _distance_to_unit(stored[drawn]) <= _distance_to_unit(encoded[drawn]):
        return stored, False
    return encoded, True


def _distance_to_unit(vectors: Float) -> float:
    with np.errstate(over="ignore"):
        length = np.linalg.norm(vectors, axis=1)
    return float(np.median(np.abs(length - 1))) if len(vectors) else 0.0


def _warnings(file: Path, pixels: Pixels, normal_map: NormalMap, mask: Mask | None) -> list[str]:
    warnings = []
    if pixels.dtype == np.uint8:
        cost = "0.4" if file.suffix.lower() in (".jpg", ".jpeg") else "0.2"
        warnings.append(f"{file}: 8-bit normals are quantised, about {cost} degree each")
    strange = _not_finite(pixels)
    if mask is not None:
        strange &= mask
    if strange.any():
        warnings.append(
            f"{file}: {np.count_nonzero(strange)} pixels hold a vector that is NaN or infinite and "
            "are left out, as outside the mask"
        )
    lost = 0 if mask is None else np.count_nonzero(mask) - np.count_nonzero(normal_map.mask)
    if lost:
        warnings.append(f"{file}: {lost} pixels of the mask hold no unit vector and are left out")
    if np.mean(normal_map.normals[normal_map.mask][:, 2]) < 0:
        warnings.append(f"{file}: most normals face away from the camera, check the sign of z")
    return warnings
