"""Meshes of height maps with fewer triangles."""

from __future__ import annotations

from dataclasses import replace

import fast_simplification
import numpy as np
from scipy.ndimage import map_coordinates

from acquisition import DataError
from processing.meshes.rim import rim
from processing.surface.height_map import HeightMap
from rig.arrays import Bool, Float32, Float64, Floating, Generic, Int32

_FEWEST = 4
# How fast the accepted error grows from pass to pass. Slow growth halves the largest error, but its
# last pass may leave more triangles than requested; so may triangles of the rim that are removed.
_GROWTHS = (5.0, *7 * (7.0,))
# Distance of the point below, in lengths of the surface.
_DEPTH = 10


def simplified(
    vertices: Float32, faces: Int32, count: int, pixel_size: float
) -> tuple[Float32, Int32]:
    """Remove vertices where the surface is flattest, until a number of triangles is left.

    Edges are collapsed in the order of their quadric error (Garland and Heckbert, Surface
    simplification using quadric error metrics, 1997), by the library fast-simplification. Each edge
    of the rim gets a triangle to a point far below while this is done: the library knows no rims,
    and those of flat surfaces would shrink.

    Parameters
    ----------
    vertices
        ``(V, 3)`` float32.
    faces
        ``(F, 3)`` int32.
    count
        Number of triangles to keep. A mesh with no more triangles is returned as it is.
    pixel_size
        Distance of neighbouring vertices of the complete mesh, the unit of accepted errors.

    Returns
    -------
    vertices, faces
        The new mesh. Its vertices lie between the old ones; their order says nothing.

    Raises
    ------
    DataError
        If fewer than four triangles are requested.
    """
    if count < _FEWEST:
        raise DataError(f"{count} triangles are not a surface: keep at least {_FEWEST}")
    if len(faces) <= count:
        return vertices, faces
    scaled: Floating = vertices / np.float32(pixel_size)
    low, high = scaled.min(axis=0), scaled.max(axis=0)
    below = low[2] - _DEPTH * (high - low).max()
    start, end = rim(faces, len(vertices)).T
    skirt = np.stack([end, start, np.full_like(start, len(vertices))], axis=1)
    scaled = np.concatenate([scaled, [[*(low + high)[:2] / 2, below]]])
    closed = np.concatenate([faces, skirt.astype(np.int32)])
    for growth in _GROWTHS:
        surplus = _on_surface(scaled, closed, (low[2] + below) / 2).sum() - count
        if surplus > 0:
            scaled, closed = fast_simplification.simplify(
                scaled, closed, target_count=len(closed) - int(surplus), agg=growth
            )
    left = closed[_on_surface(scaled, closed, (low[2] + below) / 2)]
    used, renumbered = np.unique(left, return_inverse=True)
    fewer = (scaled[used] * pixel_size).astype(np.float32)
    return fewer, renumbered.reshape(left.shape).astype(np.int32)


def _on_surface(vertices: Floating, faces: Int32, level: float) -> Bool:
    """Return which triangles have all corners above a level."""
    above = (vertices[:, 2] > level)[faces]
    return above[:, 0] & above[:, 1] & above[:, 2]


def pixels_of(vertices: Float32, height_map: HeightMap) -> Float32:
    """Return where points of a surface are seen, ``(V, 2)`` float32 columns and rows."""
    camera = height_map.camera
    if camera is None or height_map.depth is None:
        rows, columns = height_map.mask.shape
        across = vertices[:, 0] / height_map.pixel_size + (columns - 1) / 2
        down = (rows - 1) / 2 - vertices[:, 1] / height_map.pixel_size
        return np.stack([across, down], axis=1).astype(np.float32)
    # The unit of a surface without a scale is the pixel, at a distance of one focal length.
    placed = replace(camera, working_distance_mm=height_map.pixel_size * camera.focal_px)
    return placed.project(vertices).astype(np.float32)


def sampled(image: Generic, mask: Bool, pixels: Float32) -> Float64:
    """Interpolate an image ``(H, W, C)`` at pixels ``(V, 2)``, from samples inside a mask alone.

    Returns
    -------
    npt.NDArray[np.float64]
        ``(V, C)``; 0 where no neighbouring pixel is inside.
    """
    places = pixels[:, ::-1].T
    inside = map_coordinates(mask.astype(np.float32), places, order=1, mode="nearest")
    values = np.zeros((len(pixels), image.shape[2]))
    for channel in range(image.shape[2]):
        samples = np.where(mask, image[..., channel], 0).astype(np.float32)
        values[:, channel] = map_coordinates(samples, places, order=1, mode="nearest")
    return values / np.maximum(inside, 1e-6)[:, None]
