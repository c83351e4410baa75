"""Fields of view for `sgp merge`: results of `sgp normals` and `sgp run`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import acquisition
import processing
from sgp.cli.exit import UsageError
from sgp.results import input_hashes
from sgp.stages.result_source import find_normals

# Stated sizes of pixels of the same camera differ by less than this share.
_SCALE = 0.01


@dataclass(frozen=True, eq=False)
class FieldResult:
    """A result whose maps are read in rows.

    Parameters
    ----------
    rows
        Its maps.
    pixel_mm
        Size of a pixel of the maps on the object, if the record states it.
    files
        Files of the maps.
    images
        Hashes of the images that it was computed from.
    """

    rows: processing.merging.FieldRows
    pixel_mm: float | None
    files: tuple[Path, ...]
    images: frozenset[str]


def open_fields(paths: Sequence[Path], max_pixels: int, opened: ExitStack) -> list[FieldResult]:
    """Open the results; their files stay open as long as ``opened``.

    Raises
    ------
    UsageError
        If a folder has no record of normals.
    DataError
        If a file is missing or cannot be read, the sizes of pixels differ, or two results are of
        the same images.
    """
    fields = [_field(path, max_pixels, opened) for path in paths]
    for one, other in combinations(fields, 2):
        if one.images & other.images:
            raise acquisition.DataError(
                f"{one.rows.name} and {other.rows.name}: were computed from the same images, so "
                "their errors are the same: give one of them"
            )
    known = [(field.pixel_mm, field.rows.name) for field in fields if field.pixel_mm is not None]
    if known:
        (least, smaller), (most, larger) = min(known), max(known)
        if most > least * (1 + _SCALE):
            raise acquisition.DataError(
                f"{smaller} has pixels of {least:g} mm and {larger} of {most:g} mm: give fields of "
                "the same scale"
            )
    return fields


def _field(path: Path, max_pixels: int, opened: ExitStack) -> FieldResult:
    found = find_normals(path)
    files = {
        name: found.folder / f"{name}.exr" for name in ("normals", "albedo", "normal_sigma_deg")
    }
    mask = found.folder / "mask.png"
    for file in (files["normals"], mask):
        if not file.is_file():
            raise UsageError(f"{path}: has no {file.name}: run sgp normals again")
    present = {name: file for name, file in files.items() if file.is_file()}
    input_hashes([*present.values(), mask])
    maps = {
        name: opened.enter_context(acquisition.pixels.ImageRows(file, max_pixels=max_pixels))
        for name, file in present.items()
    }
    height, width = size = maps["normals"].shape[:2]
    for name, values in maps.items():
        if values.shape[:2] != size:
            raise acquisition.DataError(
                f"{files[name]}: {values.shape[1]} x {values.shape[0]} pixels, but the normals "
                f"have {width} x {height}: run sgp normals again"
            )
    metrics = found.record.metrics
    common = metrics.get("normal_sigma_common_deg")
    # Without a law of the noise, the map is NaN everywhere.
    has_sigma = isinstance(metrics.get("normal_sigma_deg"), (int, float))
    rows = processing.merging.FieldRows(
        str(path),
        maps["normals"],
        acquisition.read_mask(mask, (height, width)),
        maps.get("albedo"),
        maps.get("normal_sigma_deg") if has_sigma else None,
        float(common) if isinstance(common, (int, float)) else 0.0,
    )
    return FieldResult(rows, found.pixel_mm(), (*present.values(), mask), found.images)
