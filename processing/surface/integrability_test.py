"""Whether normals are those of one surface, and whether they would be if their axes were others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from acquisition import MapRows
from rig import short_repr
from rig.arrays import Bool, Float64

Axes = Literal["right", "mirrored", "turned", "swapped"]

# The slopes of steeper normals vary too much with their errors.
_LEAST_NZ = 0.3
# Curvatures of fewer corners say little.
_FEWEST_CORNERS = 300
# The map is judged by this many square tiles of this side, those with the most normals.
_TILES, _TILE_PX = 8, 256
# Differences that are smaller than the derivatives of the map by this factor are rounding.
_ROUNDING = 1e-3
# Steps of the robust fit of a turn, and parts of the map whose scores count as independent.
_STEPS, _PARTS = 8, 16
# Share of the weights that is inside the mask, up to rounding.
_WHOLE = 0.999
# The curl with other axes must be smaller by this factor. By noise alone all are equal, within 5 %
# for the fewest corners.
_CLEARER = 0.75
# And that with the given axes must be larger than this share of all derivatives: it is 0.35 to 0.7
# of mirrored reliefs, 0.12 of a mirrored sphere, and up to 0.05 of a correct one.
_LEAST_CURL = 0.08
# And it must be that of a surface rather than that of noise (0.7), which differs by up to 5 %. Of a
# dense relief of leaves that hide each other it is 0.60; of separate slopes with steps between
# them, which are no evidence of wrong axes, it is above 0.72 with all axes.
_LIKE_A_SURFACE = 0.65

# The slopes (p, q) of a map with these axes are `matrix @ (p, q)` of a map with the right ones.
# Turns by 180 degrees do not change the curl.
_AXES: Final[dict[Axes, Float64]] = {
    "right": np.array([[1.0, 0.0], [0.0, 1.0]]),
    "mirrored": np.array([[-1.0, 0.0], [0.0, 1.0]]),
    "turned": np.array([[0.0, -1.0], [1.0, 0.0]]),
    "swapped": np.array([[0.0, 1.0], [1.0, 0.0]]),
}


@dataclass(frozen=True)
class Integrability:
    """How well normals agree with the existence of a surface.

    Parameters
    ----------
    curl
        Mean absolute difference of the two mixed second derivatives, divided by the mean sum of
        their absolute values: 0 for the normals of a surface, 1 if the map is mirrored, about 0.7
        for noise. It is that of the scale (1, 2, 4, ... pixels) at which the map is most like a
        surface: fine scales show noise, and coarse ones nothing of fine detail. NaN if too few
        normals face the camera.
    axes
        Under which axes the normals are those of a surface: ``right`` as they are; ``mirrored``
        about x or y; ``turned`` by 90 degrees; ``swapped`` x and y. ``right`` if that is not clear.
    other_curl
        The curl under `axes`.
    turn_deg, turn_sigma_deg
        Turn of all normals about the line of sight, counter-clockwise, without which they agree
        best with a surface, and its standard deviation.
    turned_curl
        The curl without this turn.
    ratio
        Difference of the mixed derivatives under the best axes, relative to that as they are.
    """

    curl: float
    axes: Axes
    other_curl: float
    turn_deg: float = float("nan")
    turn_sigma_deg: float = float("nan")
    turned_curl: float = float("nan")
    ratio: float = float("nan")

    __repr__ = short_repr


def integrability(normals: MapRows, mask: Bool) -> Integrability:
    """Compare the mixed second derivatives that normals imply, under four choices of their axes.

    The slopes p = dz/dx and q = dz/dy of a surface satisfy dp/dy = dq/dx. Mirroring the normals
    about x or y changes the sign of one of the two; turning them by 90 degrees or swapping x and y
    replaces both by other second derivatives. Turning by 180 degrees changes both signs and cannot
    be seen.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit normals, in memory or in a file.
    mask
        ``(H, W)`` bool, the pixels with a normal.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.surface import integrability
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> normals = np.dstack([x + y, x - y, 0 * x + 4])  # of a saddle
    >>> normals = (normals / np.linalg.norm(normals, axis=2, keepdims=True)).astype(np.float32)
    >>> integrability(normals, np.ones((32, 32), bool)).curl < 0.01
    True
    """
    found = [_judged(jacobian) for jacobian in _jacobians(normals, mask)]
    if not found:
        return Integrability(float("nan"), "right", float("nan"))
    return min(found, key=lambda one: one.other_curl)


def _judged(jacobian: Float64) -> Integrability:
    """Compare the mixed derivatives under all choices of the axes.

    Parameters
    ----------
    jacobian
        ``(N, 2, 2)`` derivatives of the slopes, [p or q, x or y].
    """
    size = np.linalg.norm(jacobian, axis=(1, 2))
    # Edges of parts and outlines have huge derivatives: limit each to the typical ones.
    limit = 3 * float(np.median(size))
    jacobian = jacobian * (np.minimum(size, limit) / np.maximum(size, 1e-12))[:, None, None]
    least = _ROUNDING * float(np.mean(np.minimum(size, limit)))
    curls = {name: _curl(matrix.T @ jacobian, least) for name, matrix in _AXES.items()}
    best = min(curls, key=lambda name: curls[name][0])
    clear = curls[best][0] < _CLEARER * curls["right"][0] and curls[best][1] < _LIKE_A_SURFACE
    # Mixed derivatives of spheres are small, and say little.
    clear = clear and curls["right"][0] > _LEAST_CURL * float(np.mean(np.minimum(size, limit)))
    axes: Axes = best if clear else "right"
    turn, sigma = _turn_deg(jacobian)
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    turned = _curl(np.array([[c, s], [-s, c]]) @ jacobian, least)[1]
    ratio = curls[best][0] / max(curls["right"][0], 1e-12)
    return Integrability(curls["right"][1], axes, curls[axes][1], turn, sigma, turned, ratio)


def _turn_deg(jacobian: Float64) -> tuple[float, float]:
    """Return the turn about the line of sight, and its standard deviation between parts of the map.

    Slopes that are turned by an angle have the curl ``-tan(angle)`` times their divergence.
    """
    curl = jacobian[:, 0, 1] - jacobian[:, 1, 0]
    divergence = jacobian[:, 0, 0] + jacobian[:, 1, 1]
    weight = np.ones(len(curl))
    for _ in range(_STEPS):
        slope = float((weight * curl * divergence).sum() / max(weight @ divergence**2, 1e-12))
        off = curl - slope * divergence
        spread = max(2 * float(np.median(np.abs(off))), 1e-9)
        weight = 1 / (1 + (off / spread) ** 2) ** 2
    sums = np.array(
        [
            (part @ divergence[place], (weight * divergence**2)[place].sum())
            for place in np.array_split(np.arange(len(curl)), _PARTS)
            for part in ((weight * off)[place],)
        ]
    )
    sigma = float(np.sqrt((sums[:, 0] ** 2).sum()) / max(sums[:, 1].sum(), 1e-12))
    return float(-np.degrees(np.arctan(slope))), float(np.degrees(sigma))


def _curl(jacobian: Float64, least: float) -> tuple[float, float]:
    """Return the mean absolute difference of the mixed derivatives, as it is and relative."""
    a, b = jacobian[:, 0, 1], jacobian[:, 1, 0]
    difference = float(np.mean(np.abs(a - b)))
    if difference <= least:
        return 0.0, 0.0
    return difference, difference / float(np.mean(np.abs(a) + np.abs(b)))


def _jacobians(normals: MapRows, mask: Bool) -> list[Float64]:
    """Return the derivatives of the slopes at each scale that has enough of them.

    Each scale is the one before, smoothed by a Gaussian and reduced to half: means over squares
    would turn the sign of derivatives of detail that is finer than the squares.
    """
    scales: list[list[Float64]] = []
    for tile in _tiles(mask):
        vectors, share = normals[tile[0]][:, tile[1]], mask[tile].astype(np.float32)
        for scale in range(max(vectors.shape).bit_length()):
            if scale == len(scales):
                scales.append([])
            scales[scale].append(_derivatives(vectors.astype(np.float64), share > _WHOLE))
            if min(share.shape) < 4:
                break
            # What is outside the tile is not known.
            share[[0, -1]] = share[:, [0, -1]] = 0
            vectors = np.asarray(cv2.pyrDown(vectors), np.float32)
            share = np.asarray(cv2.pyrDown(share), np.float32)
    together = [np.concatenate(parts) for parts in scales]
    return [jacobian for jacobian in together if len(jacobian) >= _FEWEST_CORNERS]


def _tiles(mask: Bool) -> list[tuple[slice, slice]]:
    """Return the tiles of a map with the most normals."""
    rows, columns = (range(0, side, _TILE_PX) for side in mask.shape)
    tiles = [(slice(r, r + _TILE_PX), slice(c, c + _TILE_PX)) for r in rows for c in columns]
    tiles.sort(key=lambda tile: -np.count_nonzero(mask[tile]))
    return tiles[:_TILES]


def _derivatives(vectors: Float64, inside: Bool) -> Float64:
    """Return the derivatives of the slopes around the corners of four pixels."""
    inside = inside & (vectors[..., 2] > _LEAST_NZ)
    z = np.where(inside, vectors[..., 2], 1.0)
    slopes = np.stack([-vectors[..., 0] / z, -vectors[..., 1] / z], axis=-1)
    # Y is up, rows run down.
    four = inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, :-1] & inside[1:, 1:]
    right = (slopes[:-1, 1:] + slopes[1:, 1:] - slopes[:-1, :-1] - slopes[1:, :-1])[four] / 2
    up = (slopes[:-1, :-1] + slopes[:-1, 1:] - slopes[1:, :-1] - slopes[1:, 1:])[four] / 2
    return np.stack([right, up], axis=-1)
