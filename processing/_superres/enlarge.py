"""Enlarge rows of a normal map tile by tile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import MapRows
from processing._detail.rotation import rotate_from_z
from processing._detail.rows import halo_rows
from processing._detail.shape_filter import ShapeFilter
from processing._metrics import angle_map_deg
from processing._normal_map import NormalMap
from processing._superres.blend import blend, roughness_gate
from processing._superres.filling import filled_outwards
from processing._superres.interpolation import (
    REACH_PX,
    bicubic,
    enlarged_mask,
    smoothly,
    units,
    without_averaging,
)
from processing._superres.method import PixelSampling
from processing._superres.model import Domain
from processing._superres.network import Network
from processing._superres.pixel_means import means_of_points, with_given
from processing._superres.tiles import Tile, enlarged_window

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Side of the square whose mean is the normal at the centre of a large pixel.
_CENTRAL_PX = 2


@dataclass(frozen=True, eq=False)
class LowMap:
    """Rows of a map of the low resolution and its components, continued beyond their mask.

    Parameters
    ----------
    normals, shape, detail
        ``(h, w, 3)`` unit vectors; the combination of shape and detail is the map.
    central
        ``(h, w, 3)`` vectors at the centres of the pixels, whose means the normals are.
    given, side
        ``(h, w, 3)`` normals that the result keeps: the means of this many pixels in each direction
        in the middle of each large pixel.
    gate
        ``(h, w)`` largest weight of a network.
    mask
        ``(h, w)`` where the map is known.
    reach
        ``(h, w)`` where the result may have pixels: the mask and its neighbours.
    """

    normals: Float
    shape: Float
    detail: Float
    central: Float
    given: Float
    side: int
    gate: Float
    mask: Mask
    reach: Mask

    @classmethod
    def of(
        cls,
        normals: MapRows,
        mask: Mask,
        rows: slice,
        scale: int,
        halo: int,
        sampling: PixelSampling = "area",
    ) -> LowMap:
        """Separate rows of a map, and continue its components as far as a network can see."""
        read = _with_margin(rows, margin_rows(halo), len(mask))
        near = _with_margin(rows, halo, len(mask))
        part = NormalMap.of_unit_vectors(
            np.ascontiguousarray(normals[read], np.float32), mask[read]
        )
        given, side = part.normals[_within(rows, read)].copy(), scale
        if sampling == "points":
            part, side = means_of_points(part, scale), _CENTRAL_PX
        cut, inner = _within(near, read), _within(rows, near)
        # One after the other, because copies of all of them would take much memory.
        vectors = [part.normals[cut].copy(), *(each[cut].copy() for each in _components(part))]
        del part
        for number, each in enumerate(vectors):
            vectors[number] = filled_outwards(each, mask[near], halo)
        central = without_averaging(vectors[0], scale)[inner]
        gate = roughness_gate(vectors[0])[inner]
        normals, shape, detail = (each[inner] for each in vectors)
        reach = reached(mask[near])[inner]
        return cls(normals, shape, detail, central, given, side, gate, mask[rows], reach)


def margin_rows(halo: int) -> int:
    """Return the rows above and below that `LowMap.of` reads, of a network with a halo."""
    # What the continuation, the filter and the means of points depend on.
    return halo + halo_rows(ShapeFilter()) + 2 * REACH_PX


def reached(mask: Mask) -> Mask:
    """Return where a result may have pixels: a mask of the low resolution and its neighbours."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


class HighTile(NamedTuple):
    """A tile of the high resolution; 0 outside its mask.

    Parameters
    ----------
    normals, mask
        The map.
    variance
        ``(H, W)`` mean-square error in radians squared; None for bicubic interpolation.
    added_deg, detail_deg
        ``(H, W)`` angles between interpolation without a network and the map, and the shape.
    """

    normals: Float
    mask: Mask
    variance: Float | None
    added_deg: Float
    detail_deg: Float


def enlarge(
    low: LowMap,
    tile: Tile,
    scale: int,
    wanted: Mask | None,
    network: Network | None,
    domain: Domain,
    self_ensemble: bool,
) -> HighTile:
    """Compute a tile of the high resolution.

    Parameters
    ----------
    low
        Rows of the map.
    tile
        Their part.
    scale
        Factor of the resolution.
    wanted
        Mask of the high resolution, of the tile; None for the enlarged mask of the map.
    network, domain, self_ensemble
        The network, None for bicubic interpolation; what it was trained on; whether the mean of
        turned copies is used.
    """
    around, inside = tile.around, enlarged_window(tile.inside, scale)
    shape = units(bicubic(low.shape[around], scale)[inside])
    mask, variance = _mask(low, tile, scale, wanted), None
    plain = normals = units(bicubic(low.normals[around], scale)[inside])
    if network is not None:
        plain = units(smoothly(low.central[around], scale)[inside])
        vectors = (low.detail if domain == "detail" else low.normals)[around]
        answer = (network.run_turned if self_ensemble else network.run)(vectors)[inside]
        sharp = units(bicubic(vectors, scale)[inside] + answer[..., :3])
        if domain == "detail":
            sharp = rotate_from_z(sharp, shape)
        square = ((sharp - normals) ** 2).sum(axis=2)
        gate = np.clip(bicubic(low.gate[around], scale)[inside], 0, 1)
        normals, variance = blend(plain, sharp, square, np.exp(answer[..., 3:]), gate)
        normals = with_given(normals, low.given[tile.core], mask, low.side)
        known = network.deviations
        variance = variance if known is None else known.corrected(variance)
    return HighTile(
        np.where(mask[..., None], normals, np.float32(0)),
        mask,
        variance,
        np.where(mask, angle_map_deg(normals, plain, mask), np.float32(0)),
        np.where(mask, angle_map_deg(plain, shape, mask), np.float32(0)),
    )


def _mask(low: LowMap, tile: Tile, scale: int, wanted: Mask | None) -> Mask:
    if wanted is None:
        inside = enlarged_window(tile.inside, scale)
        return enlarged_mask(low.mask[tile.around], scale)[inside]
    return low.reach[tile.core].repeat(scale, axis=0).repeat(scale, axis=1) & wanted


def _with_margin(rows: slice, margin: int, height: int) -> slice:
    return slice(max(rows.start - margin, 0), min(rows.stop + margin, height))


def _within(rows: slice, outer: slice) -> slice:
    """Return rows as rows of a part of the map."""
    return slice(rows.start - outer.start, rows.stop - outer.start)


def _components(normal_map: NormalMap) -> tuple[Float, Float]:
    """Return shape and detail; a map that is smaller than the filter's window is padded."""
    shape_filter = ShapeFilter()
    least = 2 * shape_filter.w + 1
    rows, columns = (max(least - length, 0) for length in normal_map.size)
    padded = NormalMap.of_unit_vectors(
        np.pad(normal_map.normals, ((0, rows), (0, columns), (0, 0))),
        np.pad(normal_map.mask, ((0, rows), (0, columns))),
    )
    height, width = normal_map.size
    shape, detail = (part.normals[:height, :width] for part in shape_filter.split(padded))
    return shape, detail
