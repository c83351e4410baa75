"""The recording that a result was computed from, found by its record."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, cast

from pydantic import JsonValue

import acquisition
from sgp.cli.exit import UsageError
from sgp.cli.options import RIG_LIGHTS, RecordingOptions
from sgp.results import CALIBRATIONS, ResultRecord, output_fault, read_record, sha256
from sgp.stages.recording import Recording, open_recording, with_scale

_RECORD = "normals.json"
SURFACE_RECORD = "surface.json"
_LIGHTS = "lights.json"
# Options whose values are lists in a record.
_LISTS = ("exclude", "crop")


@dataclass(frozen=True, eq=False)
class NormalsResult:
    """The normals of a result.

    Parameters
    ----------
    folder
        The folder with the maps.
    depth
        Map of the depth of the surface; None without such a map.
    record
        The record in the folder.
    """

    folder: Path
    depth: Path | None
    record: ResultRecord

    @property
    def record_file(self) -> Path:
        """Path of the record."""
        return self.folder / _RECORD

    def height_mm(self) -> float:
        """Return the mean height of the object above the working plane; 0 if it is not known."""
        found = self.record.metrics.get("mean_height_mm")
        return float(found) if isinstance(found, (int, float)) else 0.0

    @property
    def images(self) -> frozenset[str]:
        """Hashes of the images of the object; empty in records of earlier programs."""
        names, inputs = self.record.parameters.get("images"), self.record.inputs
        known = names if isinstance(names, list) else []
        return frozenset(inputs[str(name)] for name in known if str(name) in inputs)

    def pixel_mm(self) -> float | None:
        """Return the size of a pixel of the maps, None if no option stated it.

        The option is the size of a pixel of the recording, the maps may be reduced.
        """
        size, factor = map(self.record.parameters.get, ("pixel_mm", "downscale"))
        if not isinstance(size, (int, float)):
            return None
        return size * (factor if isinstance(factor, int) else 1)


def has_normals(path: Path) -> bool:
    """Return whether a folder is a result with normals."""
    return any((folder / _RECORD).is_file() for folder in (path / "normals", path))


def find_normals(path: Path) -> NormalsResult:
    """Return the normals of a result of ``sgp run``, ``sgp demo`` or ``sgp normals``.

    Raises
    ------
    UsageError
        If the folder has no record of normals.
    DataError
        If the record cannot be read.
    """
    for folder in (path / "normals", path):
        if (folder / _RECORD).is_file():
            depth = path / "surface" / "depth.exr"
            known = folder != path and depth.is_file()
            return NormalsResult(folder, depth if known else None, read_record(folder / _RECORD))
    raise UsageError(
        f"{path}: has neither {_RECORD} nor normals/{_RECORD}: give a folder that sgp run or sgp "
        "normals has written"
    )


def recorded_pixel_mm(normals: Path) -> float | None:
    """Return the size of a pixel that the record of a normal map states, None without one."""
    try:
        return find_normals(normals if normals.is_dir() else normals.parent).pixel_mm()
    except UsageError:
        return None


def find_surface(path: Path) -> tuple[Path, ResultRecord]:
    """Return the folder and the record of a surface of ``sgp run``, ``sgp demo``, ``sgp surface``.

    Raises
    ------
    UsageError
        If the folder has no record of a surface.
    DataError
        If the record cannot be read.
    """
    for folder in (path / "surface", path):
        if (folder / SURFACE_RECORD).is_file():
            return folder, read_record(folder / SURFACE_RECORD)
    raise UsageError(
        f"{path}: has neither {SURFACE_RECORD} nor surface/{SURFACE_RECORD}: give a folder that "
        "sgp run or sgp surface has written"
    )


def check_unchanged(file: Path, record: ResultRecord) -> None:
    """Check that an output is the one that a record names, if it states hashes.

    Raises
    ------
    DataError
        If it is not.
    """
    known = record.files.get(file.name)
    if known is not None and (fault := output_fault(file, known.bytes, known.sha256)):
        raise acquisition.DataError(f"{file}: {fault}: run `{record.command}` again")


def open_source_of(
    path: Path, found: NormalsResult, max_pixels: int
) -> tuple[Recording, float | None] | None:
    """Open the recording of a result as its record says; None if its files are gone.

    Returns
    -------
    recording, pixel_mm
        The recording, and the size of its pixels if the record states it.

    Raises
    ------
    DataError
        If a file has changed since, or can no longer be read.
    """
    record = found.record
    source = record.parameters.get("source")
    inputs = [Path(name) for name in record.inputs]
    if not isinstance(source, str) or not Path(source).exists():
        return None
    if not all(file.is_file() for file in inputs):
        return None
    for file in inputs:
        if sha256(file) != record.inputs[str(file)]:
            raise acquisition.DataError(
                f"{file}: has changed since {found.folder} was computed: compute the result again"
            )
    options = RecordingOptions(**_options(path, found, max_pixels))
    recording = open_recording(Path(source), options)
    pixel_mm = record.parameters.get("pixel_mm")
    scale = float(pixel_mm) if isinstance(pixel_mm, (int, float)) else None
    scaled, size = with_scale(recording.source, scale)
    return Recording(_moved_back(scaled, record), recording.files), size


def _moved_back(source: acquisition.Source, record: ResultRecord) -> acquisition.Source:
    """Return a source whose images are moved back as those of the result were."""
    # The reader of the record has checked its figures.
    shifts = cast("dict[str, list[float]]", record.metrics.get("shifts_px", {}))
    return replace(source, shifts_px={name: (by[0], by[1]) for name, by in shifts.items()})


def _options(path: Path, found: NormalsResult, max_pixels: int) -> dict[str, Any]:
    """Return the options of the recording from the record."""
    known = found.record.parameters
    chosen: dict[str, Any] = {}
    for field in fields(RecordingOptions):
        value: JsonValue = known.get(field.name)
        if value is None:
            continue
        if field.name in CALIBRATIONS:
            chosen[field.name] = Path(str(value))
        elif field.name in _LISTS and isinstance(value, list):
            chosen[field.name] = tuple(value)
        elif field.name in ("distant", "gamma", "downscale"):
            chosen[field.name] = value
    if chosen.get("lights") == RIG_LIGHTS and known.get("rig") is not None:
        chosen["rig"] = Path(str(known["rig"]))
    disagreed = found.record.metrics.get("excluded")
    if isinstance(disagreed, list):
        chosen["exclude"] = (*chosen.get("exclude", ()), *map(str, disagreed))
    # Lights that were estimated with the result.
    for folder in (found.folder, path):
        if (folder / _LIGHTS).is_file():
            chosen["lights"] = folder / _LIGHTS
            break
    return chosen | {"max_pixels": max_pixels}
