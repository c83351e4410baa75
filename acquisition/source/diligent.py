"""Object folders in the layout of the DiLiGenT benchmark (Shi et al., 2016)."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition._errors import DataError, convert_read_errors
from acquisition.files.text_files import numbered_lines, read_text
from acquisition.source.image_folder import images_source, with_ignored
from acquisition.source.source import ReadOptions, Source
from acquisition.value_files.lights import read_lights
from acquisition.value_files.lights_text import DIRECTIONS_FILE, FILENAMES_FILE, INTENSITIES_FILE
from acquisition.value_files.mat5 import read_mat5
from rig import Notice, UnreadableError, read_bounded
from rig.arrays import Float32
from rig.files import MAX_BINARY_BYTES

_TRUTH_FILE = "Normal_gt.mat"
_TRUTH_VARIABLE = "Normal_gt"
_LONGEST = 1e100


def is_diligent(folder: Path) -> bool:
    """Return whether a folder is a DiLiGenT folder."""
    return (folder / FILENAMES_FILE).is_file() or (folder / DIRECTIONS_FILE).is_file()


def read_diligent(folder: Path, options: ReadOptions) -> Source:
    """Read an object folder: the images of filenames.txt with lights, mask and true normals.

    Raises
    ------
    DataError
        If a file is missing, the counts differ, or mask or normals have another size.
    """
    if not (folder / FILENAMES_FILE).is_file():
        raise DataError(
            f"{folder}: has {DIRECTIONS_FILE} but no {FILENAMES_FILE}: restore it, or move "
            f"{DIRECTIONS_FILE} to another folder and give it as lights"
        )
    names = [name for _, name in numbered_lines(read_text(folder / FILENAMES_FILE))]
    if not names:
        raise DataError(f"{folder / FILENAMES_FILE}: an empty file: list the images")
    for name, count in Counter(names).items():
        if count > 1:
            raise DataError(f"{folder / FILENAMES_FILE}: {name[:80]} is listed twice: remove one")
        # Not with pathlib, which raises an error if a name is too long.
        if not os.path.isfile(folder / name):
            raise DataError(
                f"{folder / FILENAMES_FILE}: lists {name[:80]}, which does not exist: restore the "
                "image, or remove the line"
            )
    mask = folder / "mask.png"
    images = [folder / name for name in names]
    source = images_source(folder, images, options, [mask] if mask.exists() else [])
    lights = read_lights(folder) if (folder / DIRECTIONS_FILE).is_file() else None
    truth = folder / _TRUTH_FILE
    others = [FILENAMES_FILE, _TRUTH_FILE]
    if lights is not None:
        others += [DIRECTIONS_FILE, INTENSITIES_FILE]
    warnings = source.warnings
    if lights is not None and not (folder / INTENSITIES_FILE).is_file():
        text = f"no {INTENSITIES_FILE}: all lights are assumed equally strong"
        warnings += (Notice("intensities-assumed", text, str(folder)),)
    source = replace(
        source,
        kind="diligent",
        warnings=warnings,
        lights=lights,
        normals_truth=_true_normals(truth, source.size) if truth.exists() else None,
        files=(*source.files, *(folder / name for name in others if (folder / name).exists())),
    )
    return with_ignored(source, folder)


def _true_normals(path: Path, size: tuple[int, int]) -> Float32:
    with convert_read_errors(path):
        data = read_bounded(path, MAX_BINARY_BYTES)
    try:
        normals = read_mat5(data, _TRUTH_VARIABLE, size[0] * size[1] * 3)
    except UnreadableError as error:
        raise DataError(
            f"{path}: no variable {_TRUTH_VARIABLE} can be read ({error}): restore the file"
        ) from error
    if normals.shape != (*size, 3):
        raise DataError(
            f"{path}: normals of shape {normals.shape}, but the images have {size[1]} x {size[0]} "
            "pixels: restore the file of these images"
        )
    # Longer vectors are not normals, and computing their length would overflow.
    normals[~(np.abs(normals) < _LONGEST).all(axis=2)] = 0
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    valid = length > 0.5
    unit = np.divide(normals, length, out=np.zeros_like(normals), where=valid)
    truth: Float32 = unit.astype(np.float32)
    return truth
