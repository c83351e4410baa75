"""A surface in millimetres with its error bars, from a result."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from processing.roughness import ErrorModel, NormalErrors, Resolution
from processing.surface.grid_graph import label_parts
from rig.arrays import Bool, Float32, Int32
from sgp.cli.exit import UsageError
from sgp.pictures.jumps import JUMP_DOWN, JUMP_RIGHT
from sgp.results import ResultRecord, input_hashes, sha256
from sgp.stages.result_source import NormalsResult, find_normals
from sgp.stages.sigma_map import read_sigma
from sgp.stages.surface_export import read_heights


@dataclass(frozen=True, eq=False)
class SurfaceInput:
    """A surface that a command measures.

    Parameters
    ----------
    heights_mm
        ``(H, W)`` float32, NaN outside the mask.
    parts
        ``(H, W)`` int32 parts whose relative heights are not known, -1 for pixels without
        neighbours; None if there is one.
    resolution
        What the instrument transmits.
    errors
        Error bars; None if the result has none.
    joined
        Whether known heights have determined the surface.
    normals
        The normals that were integrated; None if they are gone.
    files, notices
        The files, and notices about them.
    """

    heights_mm: Float32
    parts: Int32 | None
    resolution: Resolution
    errors: ErrorModel | None
    joined: bool
    normals: NormalsResult | None
    files: list[Path]
    notices: list[rig.Notice] = field(default_factory=list)


def read_surface(path: Path, *, scale_sigma: float, max_pixels: int) -> SurfaceInput:
    """Read the surface of a result of ``sgp run``, ``sgp demo`` or ``sgp surface``.

    Parameters
    ----------
    path
        Folder of the result.
    scale_sigma
        Relative standard deviation of the size of a pixel.
    max_pixels
        Refuse images with more pixels than this.

    Raises
    ------
    UsageError
        If the folder has no surface.
    DataError
        If its heights are in pixels, or a file is missing or cannot be read.
    """
    surface = read_heights(path, max_pixels)
    folder, record = surface.record_file.parent, surface.record
    height_file = surface.height_file
    metrics = record.metrics
    heights = np.where(np.isfinite(surface.height), surface.height, np.float32(math.nan))
    files = [surface.record_file, height_file]
    distance = surface.camera_mm
    pixel = surface.pixel_mm
    if distance is not None and np.isfinite(heights).any():
        # Nearer pixels are smaller.
        pixel *= 1 - float(np.nanmean(heights)) / distance
    jumps = folder / "jumps.png"
    files += [jumps] if jumps.is_file() else []
    joined = "prior_heights" in metrics
    parts = None
    if not joined and _has_parts(record, jumps):
        parts = _parts(np.isfinite(heights), jumps, max_pixels)
    notices = list[rig.Notice]()
    normals = _normals_of(path, folder, record)
    errors, blur = None, None
    if normals is not None:
        sigma_file = normals.folder / "normal_sigma_deg.exr"
        stated = normals.record.metrics.get("lens_blur_px")
        blur = float(stated) if isinstance(stated, (int, float)) else None
        known = isinstance(normals.record.metrics.get("normal_sigma_deg"), (int, float))
        if known and sigma_file.is_file():
            read = processing.read_normals(normals.folder, max_pixels=max_pixels)
            sigma = read_sigma(sigma_file, read.normal_map.mask, max_pixels)
            files += [normals.record_file, *read.files, sigma_file]
            notices += sigma.notices
            if sigma.common_deg == 0:
                notices.append(_exact_lights(normals))
            changed = [one for one in files if _changed(one, record)]
            if changed:
                raise acquisition.DataError(
                    f"{changed[0]}: has changed since {folder} was computed: compute it again"
                )
            if read.normal_map.size != heights.shape:
                raise acquisition.DataError(
                    f"{normals.folder}: its size is not that of {height_file}: give a complete "
                    "result"
                )
            errors = ErrorModel(
                NormalErrors(read.normal_map.normals, sigma.sigma_deg[:], sigma.common_deg),
                math.hypot(scale_sigma, _height_share(normals, distance)),
            )
        if normals.record.verdict not in (None, "good"):
            notices.append(_verdict(normals))
    if errors is None:
        notices.append(
            rig.Notice(
                "roughness-without-errors",
                "error bars of the normals are not known, so parameters have no uncertainty, and "
                "noise is not removed from them",
                str(path),
            )
        )
    input_hashes(files)
    return SurfaceInput(
        heights_mm=heights,
        parts=parts,
        resolution=Resolution.seen(pixel, blur),
        errors=errors,
        joined=joined,
        normals=normals,
        files=files,
        notices=notices,
    )


def _has_parts(record: ResultRecord, jumps: Path) -> bool:
    count = record.metrics.get("parts")
    return jumps.is_file() or (isinstance(count, int) and count > 1)


def _parts(known: Bool, jumps: Path, max_pixels: int) -> Int32:
    """Return ``(H, W)`` the parts between holes and jumps, -1 for pixels without neighbours."""
    right, down = np.zeros((2, known.shape[0] + 2, known.shape[1] + 2), np.float32)
    right[1:-1, 1:-2] = known[:, :-1] & known[:, 1:]
    down[1:-2, 1:-1] = known[:-1] & known[1:]
    if jumps.is_file():
        where = acquisition.read_image(jumps, max_pixels=max_pixels)
        right[1:-1, 1:-1][(where == JUMP_RIGHT) | (where == JUMP_RIGHT + JUMP_DOWN)] = 0
        down[1:-1, 1:-1][where >= JUMP_DOWN] = 0
    return label_parts(right, down)[0][1:-1, 1:-1]


def _normals_of(path: Path, folder: Path, record: ResultRecord) -> NormalsResult | None:
    """Return the normals of a surface: those next to it, or those that its record names."""
    named = record.parameters.get("normals")
    for place in (path, folder.parent, Path(named) if isinstance(named, str) else None):
        if place is not None and place.is_dir():
            try:
                return find_normals(place)
            except UsageError:
                continue
    return None


def _height_share(normals: NormalsResult, distance: object) -> float:
    """Return the deviation of the mean height relative to the distance of the camera."""
    sigma = normals.record.metrics.get("mean_height_sigma_mm")
    if isinstance(sigma, (int, float)) and isinstance(distance, (int, float)):
        return float(sigma) / float(distance)
    return 0.0


def _exact_lights(normals: NormalsResult) -> rig.Notice:
    text = (
        "the lights state no errors, so their part is missing in the uncertainties: 1 degree would "
        "add about 1.5 % to that of heights and slopes"
    )
    return rig.Notice("roughness-lights-exact", text, str(normals.folder))


def _verdict(normals: NormalsResult) -> rig.Notice:
    causes = "; ".join(cause.name for cause in normals.record.causes[:2]) or "see its record"
    text = (
        f"the verdict on the normals is {normals.record.verdict} ({causes}): their error bars do "
        "not include such mistakes, so the uncertainties are not assured"
    )
    return rig.Notice("roughness-not-assured", text, str(normals.folder))


def _changed(file: Path, record: ResultRecord) -> bool:
    """Return whether a file is not the one that a surface was computed from."""
    stated = record.inputs.get(str(file))
    return stated is not None and sha256(file) != stated
