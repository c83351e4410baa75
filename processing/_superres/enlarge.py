"""Enlarge a normal map tile by tile."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from processing._detail.rotation import rotate_from_z
from processing._detail.shape_filter import ShapeFilter
from processing._metrics import angle_map_deg
from processing._normal_map import NormalMap
from processing._superres.blend import blend, roughness_gate
from processing._superres.filling import filled_outwards
from processing._superres.interpolation import (
    bicubic,
    enlarged_mask,
    smoothly,
    units,
    without_averaging,
)
from processing._superres.model import Domain
from processing._superres.network import Network
from processing._superres.pixel_means import means_of_points, with_given
from processing._superres.super_resolution import PixelSampling
from processing._superres.tiles import Tile, enlarged_window

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Side of the square whose mean is the normal at the centre of a large pixel.
_CENTRAL_PX = 2


@dataclass(frozen=True, eq=False)
class LowMap:
    """A map of the low resolution and its components, continued beyond their mask.

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
        cls, normal_map: NormalMap, scale: int, halo: int, sampling: PixelSampling = "area"
    ) -> LowMap:
        """Separate a map, and continue its components as far as a network can see."""
        mask, given, side = normal_map.mask, normal_map.normals, scale
        if sampling == "points":
            normal_map, side = means_of_points(normal_map, scale), _CENTRAL_PX
        shape, detail = _components(normal_map)
        normals, shape, detail = (
            filled_outwards(vectors, mask, halo) for vectors in (normal_map.normals, shape, detail)
        )
        near = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        central = without_averaging(normals, scale)
        gate = roughness_gate(normals)
        return cls(normals, shape, detail, central, given, side, gate, mask, near)


@dataclass(frozen=True, eq=False)
class HighMap:
    """What is known about a map of the high resolution; 0 outside its mask.

    Parameters
    ----------
    normals, mask
        The map.
    variance
        ``(H, W)`` mean-square error in radians squared.
    added_deg, detail_deg
        ``(H, W)`` angles between interpolation without a network and the map, and the shape.
    """

    normals: Float
    mask: Mask
    variance: Float
    added_deg: Float
    detail_deg: Float

    @classmethod
    def empty(cls, size: tuple[int, int]) -> HighMap:
        """Return a map without pixels.

        Raises
        ------
        MemoryError
            If it does not fit into the memory.
        """
        maps = [np.zeros(size, np.float32) for _ in range(3)]
        return cls(np.zeros((*size, 3), np.float32), np.zeros(size, np.bool_), *maps)


def enlarge(
    low: LowMap,
    tile: Tile,
    scale: int,
    wanted: Mask | None,
    network: Network | None,
    domain: Domain,
    self_ensemble: bool,
    high: HighMap,
) -> None:
    """Compute a tile of the high resolution.

    Parameters
    ----------
    low
        The map.
    tile
        Its part.
    scale
        Factor of the resolution.
    wanted
        ``(H, W)`` mask of the high resolution; None for the enlarged mask of the map.
    network, domain, self_ensemble
        The network, None for bicubic interpolation; what it was trained on; whether the mean of
        turned copies is used.
    high
        Receives the tile.
    """
    around, core = tile.around, enlarged_window(tile.core, scale)
    inside = enlarged_window(tile.inside, scale)
    shape = units(bicubic(low.shape[around], scale)[inside])
    high.mask[core] = mask = _mask(low, tile, scale, wanted)
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
        high.variance[core] = variance if known is None else known.corrected(variance)
    high.normals[core] = np.where(mask[..., None], normals, 0)
    high.added_deg[core] = np.where(mask, angle_map_deg(normals, plain, mask), 0)
    high.detail_deg[core] = np.where(mask, angle_map_deg(plain, shape, mask), 0)


def _mask(low: LowMap, tile: Tile, scale: int, wanted: Mask | None) -> Mask:
    inside = enlarged_window(tile.inside, scale)
    if wanted is None:
        return enlarged_mask(low.mask[tile.around], scale)[inside]
    near = low.reach[tile.core].repeat(scale, axis=0).repeat(scale, axis=1)
    return near & wanted[enlarged_window(tile.core, scale)]


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
