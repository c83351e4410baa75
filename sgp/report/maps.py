"""The maps of a result folder as planes of one size."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

import numpy as np

import acquisition
import processing
import rig
from rig.arrays import AnyArray, Bool, Int64
from sgp.pictures import JUMP_DOWN, Crop
from sgp.report.folder import ResultFolder, noted
from sgp.report.kinds import ALBEDO, HEIGHT, MASKS, NUMBERS, VECTORS, quantiser
from sgp.report.large_maps import Values, known, read_map, read_vectors
from sgp.report.planes import Plane, Tile, tiles_of
from sgp.results import read_record

Read = tuple[str, Values, Bool]
_MOSTLY: Final = 0.9
_KEPT: Final = 600_000_000  # bytes of maps that stay in memory


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
    tiles
        Parts of the planes at full resolution, if they were asked for.
    """

    planes: dict[str, Plane]
    full: tuple[int, int]
    crop: Crop
    pixel_size: float
    unit: str
    notices: list[rig.Notice]
    tiles: list[Tile] = field(default_factory=list)

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the planes."""
        rows, columns, _ = next(iter(self.planes.values())).samples.shape
        return rows, columns

    @property
    def mostly_invented(self) -> bool:
        """Whether there are hardly any pixels that were not invented."""
        plane = self.planes.get("invented")
        if plane is None:
            return False
        inside = next(iter(self.planes.values())).samples[..., 0] > 0
        share = (plane.samples[..., 0] > 127) & inside
        return bool(share.sum() > _MOSTLY * max(inside.sum(), 1))


class FolderMaps:
    """The maps of a folder: read when they are asked for, and kept if they are not large."""

    def __init__(self, folder: ResultFolder, max_pixels: int) -> None:
        self.folder = folder
        self.notices: list[rig.Notice] = []
        self._max_pixels = max_pixels
        self._kept: list[Read] | None = None

    def __iter__(self) -> Iterator[Read]:
        if self._kept is not None:
            yield from self._kept
            return
        self.notices.clear()
        kept: list[Read] = []
        size = 0
        for one in _read(self.folder, self._max_pixels, self.notices):
            size += getattr(one[1], "nbytes", 0)
            kept = [*kept, one] if size <= _KEPT else []
            yield one
        if size <= _KEPT:
            self._kept = kept

    def jumps(self) -> AnyArray | None:
        """Return jumps.png, if there is one."""
        path = self.folder.file("jumps.png")
        if path is not None:
            with _noted(self.notices):
                return acquisition.read_image(path, max_pixels=self._max_pixels)
        return None


def embed(maps: FolderMaps, most_pixels: float, *, full: bool = False) -> Embedded | None:
    """Reduce the maps of a folder to at most ``most_pixels``; None without maps.

    With ``full``, reduced maps also have tiles of full resolution.
    """
    folder = maps.folder
    notices: list[rig.Notice] = []
    crop: Crop | None = None
    size = (0, 0)
    planes: dict[str, Plane] = {}
    tiles: list[Tile] = []
    unit, pixel_size = scale(folder)
    for name, values, mask in maps:
        if crop is None:
            size = values.shape[0], values.shape[1]
            crop = _reduced(Crop.around(mask), most_pixels)
        if values.shape[:2] != size:
            text = f"{name}: has another size than the other maps, and is left out"
            notices.append(rig.Notice("map-unreadable", text))
            continue
        own = _unit(name, folder, unit if pixel_size is not None else "px")
        with _noted(notices):
            planes |= _planes(name, values, mask, crop, own, tiles if full else None)
    if planes and not (folder.records or folder.notices):
        text = (
            f"{folder.path}: has no record: sizes, figures and parameters are not known; the "
            "command has not finished, or its .json file was not copied"
        )
        notices.append(rig.Notice("result-unfinished", text))
    if crop is None or not planes:
        return None
    jumps = maps.jumps() if "height" in planes else None
    if jumps is not None and jumps.shape == size:
        planes["jumps"] = jumps_plane(jumps, crop, planes["height"].samples.shape[:2])
    step = (pixel_size or 1.0) * crop.step
    notices = [*maps.notices, *notices]
    return Embedded(planes, size, crop, step, unit if pixel_size else "px", notices, tiles)


def embed_beside(
    values: Values, mask: Bool, result: Embedded, most_pixels: float, *, full: bool = False
) -> Embedded:
    """Return the planes of a map that a result was computed from.

    They show the same rectangle as those of the result if the result is as large, or larger by a
    whole number.
    """
    factor = _factor(result.full, mask.shape)
    if factor is None:
        crop = _reduced(Crop.around(mask), most_pixels)
        factor = 1
    else:
        rows, columns = (
            slice(side.start // factor, -(-side.stop // factor))
            for side in (result.crop.rows, result.crop.columns)
        )
        crop = Crop(rows, columns)
        crop = replace(crop, most_px=max(crop.size) / max(1.0, result.crop.step / factor))
    tiles: list[Tile] = []
    planes = _planes("normals", values, mask, crop, "", tiles if full else None)
    size = result.pixel_size / result.crop.step * factor * crop.step
    return Embedded(planes, (mask.shape[0], mask.shape[1]), crop, size, result.unit, [], tiles)


def _factor(result: tuple[int, int], size: tuple[int, ...]) -> int | None:
    factor = round(result[0] / size[0])
    same = factor >= 1 and result == (factor * size[0], factor * size[1])
    return factor if same else None


def _reduced(crop: Crop, most_pixels: float) -> Crop:
    share = min(1.0, most_pixels / (crop.size[0] * crop.size[1]))
    return replace(crop, most_px=max(crop.size) * share**0.5)


def _planes(
    name: str, values: Values, mask: Bool, crop: Crop, unit: str, tiles: list[Tile] | None
) -> dict[str, Plane]:
    inside = mask
    if name in MASKS:
        inside = np.ones_like(mask)
    most = np.float32(np.iinfo(values.dtype).max if name in MASKS else 1)
    part = crop.picture(values, inside) / most
    whole = part
    if tiles is not None and crop.step > 1:
        whole = replace(crop, most_px=max(crop.size)).picture(values, inside) / most
    make = quantiser(name, whole, unit)
    if make is None:
        return {}
    if whole is not part and tiles is not None:
        tiles += tiles_of(name, whole, make)
    return {name: make(part)}


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
        size = found.get("pixel_mm")
        if isinstance(size, float) and size > 0:
            return "mm", size
    return unit, None


def _read(folder: ResultFolder, max_pixels: int, notices: list[rig.Notice]) -> Iterator[Read]:
    """Yield name, values and mask of the maps of a folder, one at a time."""
    mask = None
    for name, vectors, own in _vectors(folder, max_pixels, notices):
        mask = own if mask is None else mask
        yield name, vectors, own
    named = {"albedo": ALBEDO, "height": HEIGHT, **NUMBERS, **MASKS}
    for name, kind in named.items():
        path = folder.file(kind.file)
        if path is None:
            continue
        with _noted(notices):
            values = read_map(path, max_pixels)
            inside = mask
            if inside is None or inside.shape != values.shape[:2]:
                # Maps of numbers are NaN outside the object.
                inside = known(values)
            yield name, values, inside


def _vectors(folder: ResultFolder, max_pixels: int, notices: list[rig.Notice]) -> Iterable[Read]:
    """Yield the maps of directions; a folder without normals shows its detail as normals."""
    paths = {
        name: folder.file(f"{name}.exr") or folder.file(f"{name}.png")
        for name in (*VECTORS, "detail")
    }
    detail = paths.pop("detail")
    if paths["normals"] is None:
        paths = {"normals": detail or paths["shape"]}
    for name, path in paths.items():
        if path is None:
            continue
        with _noted(notices):
            yield name, *read_vectors(path, max_pixels)


_noted = partial(noted, kind="map", severity="error")


def _unit(name: str, folder: ResultFolder, unit: str) -> str:
    kind = HEIGHT if name == "height" else NUMBERS.get(name)
    path = folder.file(kind.file) if kind else None
    record = folder.record_of(path) if path else None
    stated = record.metrics.get("unit") if record else None
    own = str(stated) if stated in ("mm", "px") else unit
    if name == "curvature_mean":
        return f"1/{own}"
    return f"1/{own}²" if name == "curvature_gaussian" else own


# A reduced pixel is cut from its neighbour if this share of the pixels between them jumps.
_SHARE = 0.5


def jumps_plane(values: AnyArray, crop: Crop, size: tuple[int, int]) -> Plane:
    """Return a plane of ``size``: 1 with a jump to the right neighbour, plus 2 with one below."""
    part = values[crop.rows, crop.columns]
    down = part >= JUMP_DOWN
    right = part % JUMP_DOWN > 0
    cut = _between(right, size) + 2 * _between(down.T, size[::-1]).T
    return Plane("jumps", "flags", cut.astype(np.uint8)[..., None])


def _between(right: Bool, size: tuple[int, int]) -> Int64:
    """Return for each reduced pixel whether the surface jumps on the way to the right one."""
    rows, columns = size
    high, wide = right.shape
    row, column = np.nonzero(right)
    # The boundary between two pixels, in reduced pixels, and the middle that is left of it.
    left = np.floor((column + 1) * columns / wide - 0.5).astype(int)
    inside = (left >= 0) & (left < columns - 1)
    # A row counts once, however many jumps it has there.
    found = np.unique(row[inside] * columns + left[inside])
    place = (found // columns * rows // high) * columns + found % columns
    count = np.bincount(place, minlength=rows * columns).reshape(rows, columns)
    enough: Bool = count >= max(1.0, _SHARE * high / rows)
    return enough.astype(np.int64)


def height_differences(folder: ResultFolder) -> dict[str, list[float]] | None:
    """Return distances and the standard deviations there, in the unit; None without a record."""
    for record in folder.records.values():
        distances: Any = record.metrics.get("difference_distances_px")
        sigma: Any = record.metrics.get("difference_sigma")
        if distances and sigma and len(distances) == len(sigma):
            size = scale(folder)[1] or 1.0
            return {"distances": [size * one for one in distances], "sigma": sigma}
    return None


def camera_of(folder: ResultFolder, maps: Embedded) -> dict[str, Any] | None:
    """Return distance and axis of a perspective camera; None if the view counts as parallel.

    The axis has x to the right and y up from the middle of the embedded rectangle, in the unit.
    """
    for record in folder.records.values():
        distance: Any = record.metrics.get("camera_distance")
        axis: Any = record.metrics.get("camera_axis_px")
        if not distance or not axis or "height" not in maps.planes:
            continue
        size = maps.pixel_size / maps.crop.step
        column, row = (
            (one.start + one.stop - 1) / 2 for one in (maps.crop.columns, maps.crop.rows)
        )
        place = [size * (axis[0] - column), size * (row - axis[1])]
        return {"distance": float(distance), "axis": place}
    return None


def resolution_of(folder: ResultFolder, maps: Embedded) -> dict[str, Any] | None:
    """Return blur, origin and reduction of the heights; None if their roughness is not defined.

    The blur by lens and pixels and the origin of the rectangle are in pixels of the map; parts
    whose relative heights are not known have no roughness in common.
    """
    figures: dict[str, Any] = {}
    for record in reversed([*folder.records.values()]):
        figures |= record.metrics
    if maps.unit != "mm" or "height" not in maps.planes or figures.get("parts", 1) != 1:
        return None
    blur = figures.get("lens_blur_px", _blur_of_normals(folder))
    return {
        "blur": processing.roughness.Resolution.seen(1.0, blur).blur_px,
        "origin": [maps.crop.columns.start, maps.crop.rows.start],
        "reduction": maps.crop.step,
    }


def _blur_of_normals(folder: ResultFolder) -> Any:
    """Return the blur of the normals that `sgp surface` has integrated; None if it is not known."""
    named = folder.parameter("normals")
    if isinstance(named, str):
        place = folder.located(named)
        for path in (place / "normals" / "normals.json", place / "normals.json"):
            with suppress(acquisition.DataError, acquisition.MissingPathError):
                return read_record(path).metrics.get("lens_blur_px")
    return None
