"""DGTS, a peer: texture of a surface, synthesised by generators of displacements on triangles.

A. Hertz, R. Hanocka, R. Giryes and D. Cohen-Or, "Deep Geometric Texture Synthesis", SIGGRAPH 2020,
from the paper; sizes as in its published code (MIT licence, amirhertz/geometric-textures). Each
level has a generator and a critic of six face convolutions. A face has, for each of its edges, the
vertex opposite in the neighbour across the edge in the frame of the edge, and the length of the
edge. A convolution takes the largest of the sums with each of the three neighbours. Generators add
displacements in the frames of the faces, averaged at the vertices, to a mesh that is subdivided
from level to level; noise moves the vertices first.

The original first fits meshes of all levels to the exemplar. Here exemplar and target are height
grids, so the meshes of a level are resampled grids, cut into triangles. On a target, the shape of
each level is that of the target at that resolution, which keeps it better than subdivision of a
coarse mesh does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

import processing
from benchmarks.paper.peers.layers import Layers, NumpyLayers, Shapes, T, Weights
from benchmarks.paper.peers.protocol import Peer
from rig.arrays import Bool, Float32, Float64, Int64

LEVELS = 5
COARSEST = 4  # cells along a side of an exemplar at the first level: 32 faces
CELLS = COARSEST << LEVELS - 1
# The last level has a vertex at each pixel.
EXEMPLAR_PX = CELLS + 1
NOISE = 0.1  # standard deviation of the noise of vertices, in cells
_RIM_CELLS = 2  # around a target, of the first level
_EDGES, _FEATURES, _CONVOLUTIONS = 3, 4, 6
_NARROW, _WIDE = 32, 128
EXEMPLARS = ("lizard scales", "textile")


def weights_of(exemplar: str) -> Path:
    """Return the file of the generators that were trained on an exemplar."""
    return Path(__file__).with_name("weights") / f"dgts-{exemplar.replace(' ', '-')}.onnx"


@dataclass(frozen=True, eq=False)
class Mesh:
    """The triangles of a grid: each cell is cut from its upper right to its lower left corner.

    Parameters
    ----------
    rows, columns
        Number of cells.
    """

    rows: int
    columns: int

    @cached_property
    def faces(self) -> Int64:
        """``(F, 3)`` vertices, counter-clockwise with x to the right and y up."""
        count = (self.rows + 1) * (self.columns + 1)
        number = np.arange(count).reshape(self.rows + 1, self.columns + 1)
        a, b, d, e = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
        both = np.stack([np.stack([a, d, b], -1), np.stack([b, d, e], -1)], axis=2)
        return both.reshape(-1, 3)

    @cached_property
    def _across(self) -> tuple[Int64, Int64]:
        """For each edge of each face, the face across, and its opposite vertex; else its own."""
        faces, count = self.faces, int(self.faces.max()) + 1
        ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
        key = ends.min(axis=1) * count + ends.max(axis=1)
        order = np.argsort(key, kind="stable")
        same = np.flatnonzero(key[order][1:] == key[order][:-1])
        partner = np.arange(len(key))
        partner[order[same]], partner[order[same + 1]] = order[same + 1], order[same]
        opposite = np.roll(faces, -2, axis=1).reshape(-1)
        return (partner // 3).reshape(-1, 3), opposite[partner].reshape(-1, 3)

    @property
    def neighbours(self) -> Int64:
        """``(F, 3)`` the face across each edge, or the face itself at the rim."""
        return self._across[0]

    @property
    def opposite(self) -> Int64:
        """``(F, 3)`` the vertex across each edge."""
        return self._across[1]

    @cached_property
    def corners(self) -> tuple[Int64, Float32]:
        """``(V, 6)`` corners of faces at each vertex, and their weights, whose sum is 1."""
        flat = self.faces.reshape(-1)
        order = np.argsort(flat, kind="stable")
        counts = np.bincount(flat)
        place = np.arange(len(flat)) - np.repeat(np.cumsum(counts) - counts, counts)
        index = np.zeros((len(counts), 6), np.int64)
        weight = np.zeros((len(counts), 6), np.float32)
        index[flat[order], place] = order
        weight[flat[order], place] = (1 / counts)[flat[order]]
        return index, weight[..., None]


def widths(level: int) -> list[int]:
    """Return the widths of the five hidden convolutions of a level, as published."""
    first = min(_NARROW << level, _WIDE)
    return [max(first >> number, _NARROW) for number in range(_CONVOLUTIONS - 1)]


def face_network(
    layers: Layers[T], name: str, level: int, outputs: int, features: T, neighbours: Any
) -> T:
    """Return values of the faces, ``(F, outputs)``: the generator of a level, or its critic.

    The map of a face and a neighbour is the sum of a map of each, so that both are computed once
    for each face instead of three times.
    """
    sides = widths(level)
    rows = layers.largest(layers.dense(f"{name}.0", features, _FEATURES, sides[0]))
    for number, (inputs, width) in enumerate(zip(sides, [*sides[1:], outputs], strict=True), 1):
        rows = layers.leak(layers.standardise(rows))
        near = layers.dense(f"{name}.{number}.near", rows, inputs, width)
        own = layers.dense(f"{name}.{number}.own", rows, inputs, width)
        rows = layers.add(own, layers.largest(layers.gather(near, neighbours)))
    return rows


def weight_shapes(kind: str, level: int, outputs: int) -> dict[str, tuple[int, int]]:
    """Return outputs and inputs of each linear map by name."""
    noted = Shapes()
    face_network(noted, f"{kind}{level}", level, outputs, None, None)
    return noted.noted


def frames(vertices: Any, mesh: Mesh, stack: Callable[..., Any]) -> tuple[Any, Any, Any]:
    """Return middles and axes of the edges of all faces, and the lengths of the edges.

    Parameters
    ----------
    vertices
        ``(V, 3)`` array or tensor.
    mesh
        The triangles.
    stack
        The function of the library that stacks arrays along an axis.

    Returns
    -------
    middles, axes, lengths
        ``(F, 3, 3)``, ``(F, 3, 3, 3)`` with the axis before the coordinate, and ``(F, 3)``. The
        axes are along the edge, across it within the face, and the normal.
    """
    corners = vertices[mesh.faces]
    ends = corners[:, [1, 2, 0]]
    along = ends - corners
    normal = _cross(along[:, 0], along[:, 1], stack)
    normal = normal / _length(normal)[..., None]
    lengths = _length(along)
    x = along / lengths[..., None]
    n = stack([normal] * _EDGES, 1)
    y = _cross(x, n, stack)
    return (corners + ends) / 2, stack([x, y, n], 2), lengths


def features_of(vertices: Any, mesh: Mesh, stack: Callable[..., Any]) -> Any:
    """Return the features of faces, ``(F, 3, 4)``."""
    middles, axes, lengths = frames(vertices, mesh, stack)
    away = vertices[mesh.opposite] - middles
    local = (axes * away[:, :, None]).sum(-1)
    return stack([local[..., 0], local[..., 1], local[..., 2], lengths], -1)


def moved(vertices: Any, mesh: Mesh, deltas: Any, stack: Callable[..., Any]) -> Any:
    """Return vertices with the displacements ``(F, 3)`` of the faces, in the frames of edges."""
    _, axes, _ = frames(vertices, mesh, stack)
    vectors = (axes * deltas[:, None, :, None]).sum(2).reshape(-1, 3)
    index, weight = mesh.corners
    if not isinstance(vertices, np.ndarray):
        weight = vertices.new_tensor(weight)
    return vertices + (vectors[index] * weight).sum(1)


def doubled(grid: Float32) -> Float32:
    """Return the vertices of a grid ``(r, c, k)`` whose triangles are cut into four."""
    rows, columns, width = grid.shape
    out = np.zeros((2 * rows - 1, 2 * columns - 1, width), np.float32)
    out[::2, ::2] = grid
    out[1::2, ::2] = (grid[1:] + grid[:-1]) / 2
    out[::2, 1::2] = (grid[:, 1:] + grid[:, :-1]) / 2
    out[1::2, 1::2] = (grid[:-1, 1:] + grid[1:, :-1]) / 2
    return out


def plane(rows: int, columns: int) -> Float32:
    """Return the vertices of a flat grid, ``(rows + 1, columns + 1, 3)``, in cells; y is up."""
    row, column = np.indices((rows + 1, columns + 1))
    place = np.stack([column - columns / 2, rows / 2 - row, 0 * row], axis=-1)
    return place.astype(np.float32)


def sampled(heights: Float64, step: int, rows: int, columns: int) -> Float32:
    """Return heights in cells at the corners of cells, ``(rows + 1, columns + 1)``.

    Parameters
    ----------
    heights
        ``(H, W)`` heights in pixels; continued by their border.
    step
        Side of a cell in pixels; the corner of the first cell is the first pixel.
    rows, columns
        Number of cells.
    """
    smooth = heights.astype(np.float32)
    if step > 1:
        smooth = np.asarray(cv2.GaussianBlur(smooth, (0, 0), step / 3), np.float32)
    row, column = (
        np.minimum(step * np.arange(count + 1), length - 1)
        for count, length in zip((rows, columns), heights.shape, strict=True)
    )
    return np.asarray(smooth[row[:, None], column] / step, np.float32)


def with_levels(heights: Float64, rows: int, columns: int) -> list[Float32]:
    """Return the vertices of a surface at all levels, each in its own cells.

    Parameters
    ----------
    heights
        ``(H, W)`` heights in pixels.
    rows, columns
        Number of cells of the last level, a multiple of 16.
    """
    made = []
    for level in range(LEVELS):
        step = 1 << LEVELS - 1 - level
        grid = plane(rows // step, columns // step)
        grid[..., 2] = sampled(heights, step, rows // step, columns // step)
        made.append(grid)
    return made


def generate(
    weights: Weights,
    bases: Sequence[Float32],
    noises: Sequence[Float32 | None],
    levels: int = LEVELS,
) -> Float32:
    """Return the vertices of a surface with texture, in cells of the last level that is used.

    Parameters
    ----------
    weights
        Generators of all levels.
    bases
        Vertices of the shape at each level, ``(r + 1, c + 1, 3)``.
    noises
        Displacements of the vertices of each level before its generator; None for none.
    levels
        Number of levels that are used.
    """
    layers: Layers[Float32] = NumpyLayers(weights)
    moves = np.zeros(bases[0].shape, np.float32)
    for level in range(levels):
        if level:
            moves = doubled(np.asarray(2 * moves, np.float32))
        grid = bases[level]
        mesh = Mesh(grid.shape[0] - 1, grid.shape[1] - 1)
        start = grid + moves
        made = step(layers, start.reshape(-1, 3), mesh, level, noises[level])
        moves = np.asarray(made.reshape(grid.shape) - grid, np.float32)
    return np.asarray(bases[levels - 1] + moves, np.float32)


def step(
    layers: Layers[Float32], vertices: Float32, mesh: Mesh, level: int, noise: Float32 | None
) -> Float32:
    """Return the vertices after the generator of a level."""
    noisy = vertices if noise is None else vertices + noise.reshape(-1, 3)
    features = features_of(noisy, mesh, np.stack)
    deltas = face_network(layers, f"generator{level}", level, 3, features, mesh.neighbours)
    return np.asarray(moved(vertices, mesh, deltas, np.stack), np.float32)


def noises_of(bases: Sequence[Float32], seed: int) -> list[Float32]:
    """Return noise for all levels."""
    random = np.random.default_rng(seed)
    return [random.normal(scale=NOISE, size=one.shape).astype(np.float32) for one in bases]


def kept_noise() -> list[Float32 | None]:
    """Return the noise from which generators learned to reconstruct the exemplar."""
    first = plane(COARSEST, COARSEST)
    random = np.random.default_rng(2020)
    return [
        random.normal(scale=NOISE, size=first.shape).astype(np.float32),
        *[None] * (LEVELS - 1),
    ]


def normals_of(vertices: Float32, mask: Bool) -> processing.NormalMap:
    """Return the normal map of a grid of vertices, the first of which is at the first pixel.

    A pixel of the mask that the surface does not cover has the normal of the nearest one.
    """
    rows, columns = (length - 1 for length in vertices.shape[:2])
    points = vertices.reshape(-1, 3).astype(np.float64)
    # The grid may exceed the image at its right and lower side.
    points[:, 0] += (columns - (mask.shape[1] - 1)) / 2
    points[:, 1] -= (rows - (mask.shape[0] - 1)) / 2
    surface = processing.Geometry(points, Mesh(rows, columns).faces.astype(np.int32))
    drawn = processing.project(surface, size=mask.shape, pixel_mm=1.0, centred=False).normal_map
    row, column = _nearest(drawn.mask)
    return processing.NormalMap.from_vectors(drawn.normals[row, column], mask)


def onto(target: processing.NormalMap, weights: Weights, seed: int) -> processing.NormalMap:
    """Return a target with synthesised texture.

    Parameters
    ----------
    target
        The shape component of a map.
    weights
        Generators that were trained on an exemplar.
    seed
        Seed of the noise.
    """
    inside = [np.flatnonzero(target.mask.any(axis=axis)) for axis in (1, 0)]
    window = slice(inside[0][0], inside[0][-1] + 1), slice(inside[1][0], inside[1][-1] + 1)
    mask = target.mask[window].copy()
    surface = processing.integrate(
        processing.NormalMap(target.normals[window].copy(), mask), discontinuity=False
    )
    heights = np.asarray(surface.height, np.float64)[_nearest(surface.mask)]
    # Generators do not know rims but that of the exemplar: they lie outside the window.
    rim = _RIM_CELLS << LEVELS - 1
    heights = np.pad(heights, rim, mode="edge")
    most = 1 << LEVELS - 1
    rows, columns = (-(-(length - 1) // most) * most for length in heights.shape)
    bases = with_levels(heights, rows, columns)
    made = normals_of(generate(weights, bases, noises_of(bases, seed)), np.pad(mask, rim))
    normals = np.zeros_like(target.normals)
    normals[window] = made.normals[rim:-rim, rim:-rim]
    return processing.NormalMap(normals, target.mask)


def _nearest(mask: Bool) -> tuple[Int64, Int64]:
    """Return row and column of the nearest pixel of a mask for every pixel."""
    row, column = distance_transform_edt(~mask, return_indices=True)[1]
    return row, column


def _cross(first: Any, second: Any, stack: Callable[..., Any]) -> Any:
    ax, ay, az = first[..., 0], first[..., 1], first[..., 2]
    bx, by, bz = second[..., 0], second[..., 1], second[..., 2]
    return stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def _length(vectors: Any) -> Any:
    return ((vectors**2).sum(-1) + 1e-12) ** 0.5


def _fit(weights: Weights) -> Callable[[processing.NormalMap], processing.NormalMap]:
    return lambda target: onto(target, weights, seed=1)


PEER = Peer("DGTS", "Hertz et al., SIGGRAPH 2020", _fit)
