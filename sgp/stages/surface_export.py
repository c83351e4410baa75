"""The surface of a result as a file of ISO 25178-72."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from rig.arrays import Float32
from sgp.cli.exit import UsageError
from sgp.results import Result, ResultRecord, X3pMetrics
from sgp.stages.result_source import SURFACE_RECORD, check_unchanged, find_surface

_HEIGHT = "height.exr"


@dataclass(frozen=True, eq=False)
class SurfaceResult:
    """The heights of a result, in mm.

    Parameters
    ----------
    record_file, record
        The record and its path.
    height_file
        Path of the map.
    height
        ``(H, W)`` float32 in mm, NaN without a height.
    pixel_mm
        Distance between neighbouring pixels, of a perspective surface at the working distance.
    camera_mm
        Distance of the camera from the height 0; None if the surface is orthographic.
    """

    record_file: Path
    record: ResultRecord
    height_file: Path
    height: Float32
    pixel_mm: float
    camera_mm: float | None


def read_heights(path: Path, max_pixels: int) -> SurfaceResult:
    """Read the surface of a result of ``sgp run``, ``sgp demo`` or ``sgp surface``.

    Raises
    ------
    UsageError
        If the folder has no surface, or one without a scale.
    DataError
        If a file cannot be read, or is not the one that the record names.
    """
    folder, record = find_surface(path)
    file = folder / _HEIGHT
    check_unchanged(file, record)
    if record.metrics.get("unit") != "mm":
        raise UsageError(
            f"{file}: the heights are in pixels, because the scale is not known: compute the "
            "surface again with --pixel-mm, or with a camera that states its working distance"
        )
    height = acquisition.read_image(file, max_pixels=max_pixels)
    size, distance = (record.metrics.get(name) for name in ("pixel_size", "camera_distance"))
    if height.ndim != 2 or not isinstance(size, (int, float)):
        raise acquisition.DataError(
            f"{file}: is not the map of heights of {folder / SURFACE_RECORD}"
        )
    camera = float(distance) if isinstance(distance, (int, float)) else None
    heights = height.astype(np.float32, copy=False)
    return SurfaceResult(folder / SURFACE_RECORD, record, file, heights, float(size), camera)


def write_surface_x3p(folder: Path, surface: SurfaceResult) -> Result:
    """Write ``surface.x3p`` into a folder and return its figures."""
    result = Result(inputs=[surface.record_file, surface.height_file])
    path = result.file("x3p", folder / "surface.x3p")
    processing.surface.write_x3p(path, surface.height, surface.pixel_mm, origin=_origin(surface))
    known = surface.height[np.isfinite(surface.height)].astype(np.float64)
    metrics: X3pMetrics = {
        "points": len(known),
        "pixel_mm": surface.pixel_mm,
        "height_range_mm": float(np.ptp(known)),
    }
    rows, columns = surface.height.shape
    result.summary = [
        f"{columns} x {rows} points every {surface.pixel_mm:.4g} mm, {len(known)} with a height, "
        f"range {metrics['height_range_mm']:.4g} mm"
    ]
    if surface.camera_mm is not None:
        percent = 100 * float(np.abs(known).max()) / surface.camera_mm
        metrics["width_error_percent"] = percent
        text = (
            "the camera saw this surface in perspective, and X3P has one distance between its "
            "points, that of height 0: widths at the height that is furthest from 0 are off by "
            f"{percent:.2g} %; a mesh has the place of each point"
        )
        result.warnings.append(rig.Notice("x3p-in-perspective", text))
    result.metrics = metrics
    return result


def _origin(surface: SurfaceResult) -> processing.surface.X3pOrigin:
    """Return what the file states: the recording, and the hashes of the files it is from."""
    record = surface.record
    about = record.recordings[0] if record.recordings else acquisition.Identity()
    lines = [
        f"{name}: {text}"
        for name in ("object", "place", "notes", "rights")
        if (text := " ".join(getattr(about, name).split()))
    ]
    if about.simulated:
        lines.insert(0, "SIMULATED")
    digests = {surface.record_file.name: record.record_sha256, **_hashes(record)}
    lines.append(f"{record.command}, {record.software.name} {record.software.version}")
    lines += [f"{name} sha256 {digest}" for name, digest in digests.items() if digest]
    return processing.surface.X3pOrigin(
        date=_date(about.started_utc),
        creator=about.operator,
        version=record.software.version,
        probing="software" if about.simulated else "non-contacting",
        comment="\n".join(lines),
    )


def _hashes(record: ResultRecord) -> dict[str, str]:
    return {_HEIGHT: record.files[_HEIGHT].sha256} if _HEIGHT in record.files else {}


def _date(text: str) -> datetime | None:
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        return None
    return found if found.utcoffset() is not None else None
