"""The maps of a result folder as planes of one size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

import acquisition
import processing
import rig
from sgp._panels.crop import Crop
from sgp._report.folder import ResultFolder
from sgp._report.planes import Colours, Plane, colour_plane, scalar_plane, vectors_plane

Float = npt.NDArray[np.float32]


class _Map(NamedTuple):
    """A map of numbers; `unit` of None is that of the record."""

    file: str
    label: str
    unit: str | None
    colours: Colours = "doubt"


_VECTORS: Final = {"normals": "Normals", "shape": "Shape component", "detail": "Detail component"}
_HEIGHT: Final = _Map("height.exr", "Height", None, "height")
_NUMBERS: Final = {
    "normal_sigma_deg": _Map("normal_sigma_deg.exr", "Standard deviation of the normal", "deg"),
    "height_sigma": _Map("height_sigma.exr", "Standard deviation of the height", None),
    "residual": _Map("residual.exr", "Residual of the images", "of the white level"),
    "specular": _Map("specular.exr", "Light above a matte surface", "of the white level"),
    "curl_deg": _Map("curl_deg.exr", "Contradiction of the normals (curl)", "deg"),
    "normal_residual_deg": _Map("normal_residual_deg.exr", "Angle of normals and surface", "deg"),
    "error": _Map("error.exr", "Angular error", "deg"),
    "shape_error": _Map("shape_error.exr", "Error of the shape component", "deg"),
    "detail_error": _Map("detail_error.exr", "Error of the detail component", "deg"),
    "separability": _Map("separability.exr", "Shape left in the detail", "deg"),
    "curvature_mean": _Map("curvature_mean.exr", "Mean curvature", None, "signed"),
    "curvature_gaussian": _Map("curvature_gaussian.exr", "Gaussian curvature", None, "signed"),
    "detail_height": _Map("detail_height.exr", "Height of the detail", "px", "height"),
}
_MASKS: Final = {"invented": _Map("invented.png", "Invented pixels", "1 = invented", "plain")}
_TAIL: Final = 0.005  # share of the pixels beyond each end of a colour scale


@dataclass(frozen=True, eq=False)
class Embedded:
    """The maps of a result, of one size.

    Parameters
    ----------
    planes
        By name.
    full
        Rows and columns of the maps in the folder.
    crop
        The rectangle that is embedded.
    pixel_size, unit
        Size of an embedded pixel; ``px`` if the scale is not known.
    notices
        Maps that could not be read.
    """

    planes: dict[str, Plane]
    full: tuple[int, int]
    crop: Crop
    pixel_size: float
    unit: str
    notices: list[rig.Notice]

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the planes."""
        rows, columns, _ = next(iter(self.planes.values())).samples.shape
        return rows, columns


def embed(folder: ResultFolder, most_pixels: float, max_pixels: int) -> Embedded | None:
    """Read the maps of a folder and reduce them to at most ``most_pixels``; None without maps."""
    notices: list[rig.Notice] = []
    crop: Crop | None = None
    full = (0, 0)
    planes: dict[str, Plane] = {}
    unit, pixel_size = scale(folder)
    for name, values, mask in _read(folder, max_pixels, notices):
        if crop is None:
            full = values.shape[0], values.shape[1]
            crop = Crop.around(mask)
            share = min(1.0, most_pixels / (crop.size[0] * crop.size[1]))
            crop = replace(crop, most_px=max(crop.size) * share**0.5)
        if values.shape[:2] != full:
            text = f"{name}: has another size than the other maps, and is left out"
            notices.append(rig.Notice("map-unreadable", text))
            continue
        plane = _plane(name, values, mask, crop, unit if pixel_size is not None else "px", folder)
        if plane is not None:
            planes[name] = plane
    if crop is None or not planes:
        return None
    size = (pixel_size or 1.0) * crop.step
    return Embedded(planes, full, crop, size, unit if pixel_size else "px", notices)


def scale(folder: ResultFolder) -> tuple[str, float | None]:
    """Return the unit of lengths and the size of a pixel in it; None if the size is not known."""
    unit = "px"
    for record in folder.records.values():
        found = record.metrics
        if isinstance(found.get("surface"), dict):
            found = found["surface"]  # type: ignore[assignment]
        if found.get("unit") == "mm":
            unit = "mm"
        size = found.get("pixel_size")
        if isinstance(size, float) and size > 0:
            return str(found.get("unit", unit)), size
    return unit, None


def _read(
    folder: ResultFolder, max_pixels: int, notices: list[rig.Notice]
) -> Iterator[tuple[str, npt.NDArray[Any], npt.NDArray[np.bool_]]]:
    """Yield name, values and mask of the maps of a folder, one at a time."""
    mask = None
    for name in _VECTORS:
        path = folder.file(f"{name}.exr") or folder.file(f"{name}.png")
        if path is None:
            continue
        try:
            found = processing.read_normals(path, max_pixels=max_pixels).normal_map
        except acquisition.DataError as error:
            notices.append(_unreadable(error))
            continue
        mask = found.mask if mask is None else mask
        yield name, found.normals, found.mask
    named = {"albedo": _Map("albedo.png", "Albedo", ""), "height": _HEIGHT, **_NUMBERS, **_MASKS}
    for name, kind in named.items():
        path = folder.file(kind.file)
        if path is None:
            continue
        try:
            values = acquisition.read_image(path, max_pixels=max_pixels)
        except acquisition.DataError as error:
            notices.append(_unreadable(error))
            continue
        if name != "albedo" and name not in _MASKS:
            values = values.astype(np.float32, copy=False)
        inside = mask
        if inside is None or inside.shape != values.shape[:2]:
            inside = np.ones(values.shape[:2], np.bool_)
        yield name, values, inside


def _unreadable(error: Exception) -> rig.Notice:
    return rig.Notice("map-unreadable", str(error), severity="error")


def _plane(
    name: str,
    values: npt.NDArray[Any],
    mask: npt.NDArray[np.bool_],
    crop: Crop,
    unit: str,
    folder: ResultFolder,
) -> Plane | None:
    if name in _VECTORS:
        vectors = crop.picture(values, mask)
        vectors[~np.isfinite(vectors)] = 0
        length = np.linalg.norm(vectors, axis=2, keepdims=True)
        np.divide(vectors, length, out=vectors, where=length > 0)
        return vectors_plane(name, vectors, _VECTORS[name])
    if name == "albedo":
        picture = np.nan_to_num(crop.picture(values, mask))
        return colour_plane(name, np.rint(picture).astype(np.uint8), "Albedo")
    if name in _MASKS:
        kind = _MASKS[name]
        share = crop.picture(values.astype(np.float32) / np.iinfo(values.dtype).max)
        return scalar_plane(
            name, share, kind.label, str(kind.unit), kind.colours, limits=(0.0, 1.0)
        )
    kind = _HEIGHT if name == "height" else _NUMBERS[name]
    part = crop.picture(values, mask)
    known = part[np.isfinite(part)]
    if not known.size:
        return None
    own = kind.unit or _unit(name, folder, unit)
    low, high = map(float, np.quantile(known, (_TAIL, 1 - _TAIL)))
    if name == "height":
        return scalar_plane(name, part, kind.label, own, kind.colours, bits=16, shown=(low, high))
    if kind.colours == "signed":
        most = max(abs(low), abs(high)) or 1.0
        return scalar_plane(name, part, kind.label, own, kind.colours, limits=(-most, most))
    low = 0.0 if kind.colours == "doubt" else low
    return scalar_plane(name, part, kind.label, own, kind.colours, limits=(low, high))


def _unit(name: str, folder: ResultFolder, unit: str) -> str:
    path: Path | None = folder.file((_HEIGHT if name == "height" else _NUMBERS[name]).file)
    record = folder.record_of(path) if path else None
    stated = record.metrics.get("unit") if record else None
    own = str(stated) if stated in ("mm", "px") else unit
    if name == "curvature_mean":
        return f"1/{own}"
    return f"1/{own}²" if name == "curvature_gaussian" else own
