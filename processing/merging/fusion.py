"""Fusion of placed fields into one map, in bands of rows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from acquisition import DataError, MapRows
from acquisition.files import Form, Maps
from processing.merging.field_rows import FieldRows
from processing.merging.placements import Placements
from processing.merging.resampling import (
    REACH,
    inverse,
    masked,
    rectangle_of,
    resampled,
    shift_of,
    turned,
)
from processing.noise import UNIFORM_DEG
from processing.stages.stage import Need, NormalRows, Size, Step
from rig.arrays import Bool, Float32, Float64, UInt8

# Rows of the whole that are fused at once: the same in memory and in files, so that results are.
_ROWS: Final = 256
# The interpreter, libraries and compiled kernels.
_FIXED: Final = 330_000_000
# Bytes per pixel: of the maps and of masks in memory, of a band, of a part of a field.
_MAPS, _MASKS, _BAND, _PART = 22, 4, 64, 80
_COLOURS: Final = 3
# Share of the shorter side of a field over which its weight grows from its border.
_FEATHER: Final = 0.06
_LEAST_FEATHER_PX, _MOST_FEATHER_PX = 4, 127
# Least standard deviation: none of a result is exact.
_LEAST_SIGMA_DEG: Final = 0.01


@dataclass(frozen=True)
class FusionStage:
    """The fusion of fields whose placements are known.

    The maps are ``normals`` ``(H, W, 3)``, unit vectors where a field has one and 0 elsewhere;
    ``albedo`` ``(H, W)`` or ``(H, W, 3)``; ``normal_sigma_deg`` ``(H, W)``, NaN without a normal or
    if a field has no standard deviations; ``fields`` ``(H, W)``, the number of fields that show a
    pixel.

    Each field counts by its variance, and less near its border. Errors that the pixels of a field
    have in common are not taken to become smaller by fusion.

    Parameters
    ----------
    fields
        The fields.
    placements
        Where they are.

    Raises
    ------
    DataError
        If the albedo of some fields is in colour, and that of others is not.
    """

    name: ClassVar = "fusing fields"

    fields: tuple[FieldRows, ...]
    placements: Placements

    def __post_init__(self) -> None:
        coloured = [one.name for one in self.fields if _channels(one) == _COLOURS]
        if any(_channels(one) == 1 for one in self.fields) and coloured:
            raise DataError(
                f"{', '.join(coloured)}: albedo in colour, which other fields do not have: compute "
                "all normals with the same channel"
            )

    @property
    def channels(self) -> int:
        """Channels of the albedo, 0 without one."""
        return max(map(_channels, self.fields))

    def need(self, *_: Size) -> Need:
        """Return the memory for the fields."""
        height, width = self.placements.size
        sizes = [math.prod(field.size) for field in self.fields]
        band = min(_ROWS, height) * width * (_BAND + 4 * self.channels)
        least = _FIXED + 2 * sum(sizes) + band + max(sizes) * _PART
        return Need(
            least + height * width * (_MAPS + 4 * self.channels),
            least + height * width * _MASKS,
            f"a whole of {width} x {height} pixels",
        )

    def forms(self, *_: Size) -> Mapping[str, Form]:
        """Return shapes and types of the maps."""
        size = self.placements.size
        made: dict[str, Form] = {
            "normals": ((*size, 3), np.float32),
            "normal_sigma_deg": (size, np.float32),
            "fields": (size, np.uint8),
        }
        if self.channels:
            albedo = (*size, _COLOURS) if self.channels == _COLOURS else size
            made["albedo"] = albedo, np.float32
        return made

    def steps(self, maps: Maps, *_: NormalRows, memory: int | None = None) -> list[Step]:
        """Return the step that fuses; its units are bands of rows, whatever the memory."""
        weights = [_border_weights(field.mask) for field in self.fields]
        weighted = all(field.sigma_deg is not None for field in self.fields)
        height, width = self.placements.size

        def fuse(units: slice) -> None:
            for unit in range(units.start, units.stop):
                rows = slice(unit * _ROWS, min((unit + 1) * _ROWS, height))
                band = _Band(rows, width, self.channels, weighted)
                for number, (field, weight) in enumerate(zip(self.fields, weights, strict=True)):
                    band.add(field, weight, self.placements, number)
                for name, values in band.fused().items():
                    maps[name][rows] = values

        return [Step("fuse", -(-height // _ROWS), fuse, most=1)]


class _Band:
    """Sums over the fields in some rows of the whole."""

    def __init__(self, rows: slice, width: int, channels: int, weighted: bool) -> None:
        self.rows, self.channels, self.weighted = rows, channels, weighted
        size = rows.stop - rows.start, width
        self.normals = np.zeros((*size, 3), np.float32)
        self.albedo = np.zeros((*size, channels), np.float32)
        self.weight, self.variance, self.common, self.lit = np.zeros((4, *size), np.float32)
        self.count = np.zeros(size, np.uint8)

    def add(self, field: FieldRows, weights: UInt8, placements: Placements, number: int) -> None:
        """Add a field."""
        into = placements.matrices[number]
        band = self.rows.start, self.rows.stop
        covered = rectangle_of(into, field.size, placements.size)
        if covered is None:
            return
        first, last = max(covered[0].start, band[0]), min(covered[0].stop, band[1])
        if first >= last:
            return
        rows, columns = slice(first, last), covered[1]
        size = last - first, columns.stop - columns.start
        back = inverse(into) @ shift_of(rows, columns)
        needed = rectangle_of(back, size, field.size, REACH + 2)
        if needed is None:
            return
        mask = np.ascontiguousarray(field.mask[needed])
        if not mask.any():
            return
        back = inverse(shift_of(*needed)) @ back
        feather = resampled(weights[needed].astype(np.float32), back, size, smooth=True)
        feather *= _inside(back, size, mask.shape)
        normals = masked(_read(field.normals, needed), mask, back, size)
        length = np.sqrt(np.einsum("ijk,ijk->ij", normals, normals))
        seen = (feather > 0) & (length > 0.5)
        normals /= np.maximum(length, np.float32(0.5))[..., None]
        turned(normals, math.atan2(into[1, 0], into[0, 0]))
        tilt = placements.tilts[number]
        if tilt.any():
            normals = normals @ Rotation.from_rotvec(tilt).as_matrix().T.astype(np.float32)
        share = feather / np.float32(255)
        weight = np.where(seen, share * share * (3 - 2 * share), np.float32(0))
        at = slice(first - band[0], last - band[0]), columns
        if self.weighted and field.sigma_deg is not None:
            sigma = np.nan_to_num(_read(field.sigma_deg, needed), nan=UNIFORM_DEG)
            sigma = masked(sigma, mask, back, size)
            sigma = np.clip(sigma, _LEAST_SIGMA_DEG, UNIFORM_DEG).astype(np.float32)
            weight /= sigma**2
            common = np.minimum(np.float32(field.common_sigma_deg), sigma)
            self.variance[at] += weight**2 * (sigma**2 - common**2)
            self.common[at] += weight * common
        self.normals[at] += weight[..., None] * normals
        self.weight[at] += weight
        self.count[at] += seen
        if self.channels and field.albedo is not None:
            albedo = masked(_read(field.albedo, needed), mask, back, size)
            albedo = np.maximum(albedo.reshape(*size, -1), 0)
            gain = np.float32(placements.gains[number])
            self.albedo[at] += (gain * weight)[..., None] * albedo
            self.lit[at] += weight

    def fused(self) -> dict[str, Float32 | UInt8]:
        """Return the rows of all maps."""
        length = np.sqrt(np.einsum("ijk,ijk->ij", self.normals, self.normals))
        seen = (self.weight > 0) & (length > 0)
        unit = self.normals / np.where(seen, length, np.float32(1))[..., None]
        unit[~seen] = 0
        made: dict[str, Float32 | UInt8] = {"normals": unit.astype(np.float32, copy=False)}
        whole = np.where(seen, self.weight, np.float32(1))
        sigma = np.sqrt(self.variance / whole**2 + (self.common / whole) ** 2)
        known = seen & self.weighted
        made["normal_sigma_deg"] = np.where(known, sigma, np.float32(np.nan)).astype(np.float32)
        made["fields"] = np.where(seen, self.count, np.uint8(0))
        if self.channels:
            lit = np.where(self.lit > 0, self.lit, np.float32(1))[..., None]
            albedo = np.where(seen[..., None], self.albedo / lit, np.float32(0))
            made["albedo"] = albedo if self.channels == 3 else albedo[..., 0]
        return made


def _channels(field: FieldRows) -> int:
    if field.albedo is None:
        return 0
    return 1 if len(field.albedo.shape) == 2 else field.albedo.shape[2]


def _read(values: MapRows, part: tuple[slice, slice]) -> Float32:
    rows, columns = part
    return np.ascontiguousarray(values[rows][:, columns], np.float32)


def _border_weights(mask: Bool) -> UInt8:
    """Return weights ``(H, W)`` that grow from 1 at the border of a mask to 255; 0 outside."""
    feather = min(mask.shape) * _FEATHER
    feather = min(max(feather, _LEAST_FEATHER_PX), _MOST_FEATHER_PX)
    around = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    distance = cv2.distanceTransform(around, cv2.DIST_L2, 5)[1:-1, 1:-1]
    found = np.clip(distance * (255 / feather), 1, 255)
    return np.where(mask, found, 0).astype(np.uint8)


def _inside(matrix: Float64, size: Size, limits: Size) -> Bool:
    """Return which pixels of an image are within the pixels of another one."""
    columns, rows = np.arange(size[1]), np.arange(size[0])[:, None]
    x = matrix[0, 0] * columns + matrix[0, 1] * rows + matrix[0, 2]
    y = matrix[1, 0] * columns + matrix[1, 1] * rows + matrix[1, 2]
    return np.asarray((x >= -0.5) & (y >= -0.5) & (x < limits[1] - 0.5) & (y < limits[0] - 0.5))
