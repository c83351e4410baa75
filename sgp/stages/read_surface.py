"""A surface in millimetres with its error bars, from a result."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import acquisition
import processing
import rig
from processing.roughness import ErrorModel, NormalErrors, Resolution
from processing.surface.grid_graph import label_parts
from rig.arrays import Bool, Float32, Floating, Int32
from sgp.pictures.jumps import JUMP_DOWN, JUMP_RIGHT
from sgp.results import ResultRecord, input_hashes, sha256
from sgp.stages.result_source import NormalsResult, check_unchanged, find_normals, has_normals
from sgp.stages.sigma_map import read_sigma
from sgp.stages.surface_export import read_heights

# Notices of a surface whose parts or pieces are not all held by known heights.
_UNKNOWN = ("surface-in-parts", "height-guessed")


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
        What the instrument transmits, at the height 0.
    camera_mm
        Distance of the camera from the height 0; None if lines of sight are parallel.
    errors
        Error bars; None if the result has none.
    known_mm
        Standard deviation of the known heights that determine all parts of the surface; None
        without them.
    files, notices
        The files, and notices about them.
    """

    heights_mm: Float32
    parts: Int32 | None
    resolution: Resolution
    camera_mm: float | None
    errors: ErrorModel | None
    known_mm: float | None
    files: list[Path]
    notices: list[rig.Notice] = field(default_factory=list)

    def resolution_of(self, heights_mm: Floating) -> Resolution:
        """Return the resolution at the mean of some heights: nearer pixels are smaller."""
        known = heights_mm[np.isfinite(heights_mm)]
        if self.camera_mm is None or not known.size:
            return self.resolution
        share = 1 - float(known.mean(dtype=np.float64)) / self.camera_mm
        return replace(self.resolution, pixel_mm=share * self.resolution.pixel_mm)


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
    metrics: Any = record.metrics
    heights = np.where(np.isfinite(surface.height), surface.height, np.float32(math.nan))
    files = [surface.record_file, surface.height_file]
    jumps = folder / "jumps.png"
    check_unchanged(jumps, record)
    files += [jumps] if jumps.is_file() else []
    parts, known_mm = None, None
    if "prior_rms" in metrics and not any(one.code in _UNKNOWN for one in record.notices):
        known_mm = math.hypot(*(float(metrics.get(f"prior_{one}", 0)) for one in ("rms", "sigma")))
    if known_mm is None and (jumps.is_file() or metrics.get("parts", 1) > 1):
        parts = _parts(np.isfinite(heights), jumps, max_pixels)
    notices = list[rig.Notice]()
    normals = _normals_of(path, folder, record)
    errors, blur = None, None
    if normals is not None:
        sigma_file = normals.folder / "normal_sigma_deg.exr"
        figures: Any = normals.record.metrics
        blur = figures.get("lens_blur_px")
        if figures.get("normal_sigma_deg") is not None and sigma_file.is_file():
            read = processing.read_normals(normals.folder, max_pixels=max_pixels)
            sigma = read_sigma(sigma_file, read.normal_map.mask, max_pixels)
            files += [normals.record_file, *read.files, sigma_file]
            notices += sigma.notices
            if sigma.common_deg == 0:
                notices.append(_exact_lights(normals))
            for one in (*read.files, sigma_file):
                check_unchanged(one, normals.record)
            height = figures.get("mean_height_sigma_mm") or 0.0
            errors = ErrorModel(
                NormalErrors(read.normal_map.normals, sigma.sigma_deg[:], sigma.common_deg),
                math.hypot(scale_sigma, height / (surface.camera_mm or math.inf)),
            )
            if normals.record.verdict not in (None, "good"):
                notices.append(_verdict(normals))
                doubt = f"the verdict on the normals is {normals.record.verdict}"
                errors = replace(errors, doubts=(doubt,))
    if errors is None:
        text = (
            "error bars of the normals are not known, so parameters have no uncertainty, and noise "
            "is not removed from them"
        )
        notices.append(rig.Notice("roughness-without-errors", text, str(path)))
    input_hashes(files)
    seen = Resolution.seen(surface.pixel_mm, blur)
    return SurfaceInput(heights, parts, seen, surface.camera_mm, errors, known_mm, files, notices)


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
    """Return the normals of a surface: those next to it, or those that its record names.

    Raises
    ------
    DataError
        If all that are there are others.
    """
    named = record.parameters.get("normals")
    others = None
    for place in (path, folder.parent, Path(named) if isinstance(named, str) else None):
        if place is not None and has_normals(place):
            found = find_normals(place)
            if _integrated(found, record):
                return found
            others = others or found
    if others is not None:
        raise acquisition.DataError(
            f"{others.folder}: has changed since {folder} was computed, or is of another object: "
            "compute the surface again, or move it elsewhere to measure without error bars"
        )
    return None


def _integrated(normals: NormalsResult, record: ResultRecord) -> bool:
    """Return whether a surface is of these normals: by its run, or by the hash of their map."""
    if normals.record.command == record.command:
        return normals.record.inputs.items() <= record.inputs.items()
    hashes = {sha256(file) for file in normals.folder.glob("normals.*")}
    return not hashes.isdisjoint(record.inputs.values())


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
