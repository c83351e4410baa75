"""The maps of one field of view, from a result."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from processing.registration import Field
from rig.arrays import Float32
from sgp.cli.exit import UsageError
from sgp.stages.maps import MapInput
from sgp.stages.result_source import NormalsResult, find_normals, open_source_of
from sgp.stages.sigma_map import read_sigma


@dataclass(frozen=True, eq=False)
class FieldInput:
    """A field that a command reads, with its scale.

    Parameters
    ----------
    field
        The maps.
    pixel_mm
        Size of a pixel on the object; None if it is not known.
    blur_px
        Standard deviation of the blur of the lens; None if it is not known.
    images
        Hashes of the images of the object that the field was computed from; empty if they are not
        known.
    files, notices
        The files, and notices about them.
    """

    field: Field
    pixel_mm: float | None
    blur_px: float | None
    images: frozenset[str]
    files: list[Path]
    notices: list[rig.Notice]


def read_field(given: MapInput, pixel_mm: float | None) -> FieldInput:
    """Read the normals of a result, and its albedo and error bars if there are any.

    ``pixel_mm`` replaces the scale of the recording.
    """
    read = given.read()
    path, max_pixels = given.path, given.max_pixels
    folder, mask = read.files[0].parent, read.normal_map.mask
    files, notices = list(read.files), list(read.warnings)
    albedo: Float32 | None = None
    sigma: Float32 | None = None
    common: Float32 | None = None
    if (folder / "albedo.exr").is_file():
        files.append(folder / "albedo.exr")
        image = acquisition.read_image(files[-1], max_pixels=max_pixels).astype(np.float32)
        albedo = image if image.ndim == 2 else image.mean(axis=2)
    if (folder / "normal_sigma_deg.exr").is_file():
        files.append(folder / "normal_sigma_deg.exr")
        deviations = read_sigma(files[-1], mask, max_pixels)
        sigma = deviations.sigma_deg[:]
        common = np.full_like(sigma, deviations.common_deg)
        notices += deviations.notices
    field = Field(read.normal_map, albedo, sigma, common)
    try:
        found = find_normals(path)
    except UsageError:
        return FieldInput(field, pixel_mm, None, frozenset(), files, notices)
    blur = found.record.metrics.get("lens_blur_px")
    return FieldInput(
        field,
        pixel_mm or _pixel_mm(path, found, max_pixels),
        float(blur) if isinstance(blur, (int, float)) else None,
        found.images,
        files,
        notices,
    )


def _pixel_mm(path: Path, found: NormalsResult, max_pixels: int) -> float | None:
    """Return the size of a pixel, None if it is not known."""
    opened = open_source_of(path, found, max_pixels)
    if opened is None:
        return found.pixel_mm()
    recording, stated = opened
    unit, size = processing.surface.surface_scale(recording.source.camera, stated)
    return size if unit == "mm" else None
