"""Occlusion between points and lights by spheres, boxes, a height field, or a mesh.

Rays over a height field are traced on a grid of its heights. The grid is first lowered by its
interpolation error, so that it is nowhere above the surface. No point is then shadowed by its own
surroundings, and no bias is needed, which would leak light in other places.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rig import in_threads
from rig.arrays import Bool, Float32, Float64
from simulator.rendering.shadow_kernels import BLOCK, TILE, WALL, block
from simulator.scene.clutter import BALL, BOX
from simulator.shapes.body import HeightGrid
from simulator.shapes.bvh import TriangleTree

_ROWS = 256
# Safety factor on the interpolation error as estimated from second differences.
_SPARE = 1.5
# A grid does not resolve a surface with more than this interpolation error, in steps.
_UNRESOLVED = 0.25
_ROUNDING = 1e-6
# Lifts points of a mesh off their own triangles; far less than a pixel, far more than rounding.
_LIFT_MM = 1e-4


@dataclass(frozen=True, eq=False)
class Occluders:
    """The objects that cast shadows in a scene.

    Parameters
    ----------
    spheres
        ``(S, >= 4)`` rows of centre and radius.
    body
        The object, or None.
    boxes
        ``(B, 8)`` rows of centre, half edges, cosine and sine of the turn on the board.
    """

    spheres: Float64
    body: HeightGrid | TriangleTree | None
    boxes: Float64 = field(default_factory=lambda: np.zeros((0, 8)))

    @classmethod
    def of(
        cls, clutter: Float64, body: HeightGrid | TriangleTree | None, *spheres: Float64
    ) -> Occluders:
        """Return the objects of `Scene.clutter_table`, a body, and rows of spheres before balls."""
        balls, boxes = clutter[clutter[:, 0] == BALL], clutter[clutter[:, 0] == BOX]
        return cls(np.concatenate([*spheres, balls[:, 1:5]]), body, boxes[:, 1:])

    def occlude(
        self,
        light: Float32,
        points_mm: Float64,
        normals: Float64,
        solid: Bool,
        lamps: Float64,
        near: bool,
    ) -> Bool:
        """Remove the light that is blocked.

        Parameters
        ----------
        light
            ``(N, n)`` irradiance from lamps without occlusion; it is reduced in place to the
            irradiance from the part of each lamp that is seen.
        points_mm, normals
            ``(n, 3)`` points and normals.
        solid
            ``(n,)`` points on which the body may cast its shadow.
        lamps
            ``(N, P, 3)`` positions of P equal parts of each lamp in mm, or directions toward them
            if not ``near``.
        near
            Whether ``lamps`` are positions.

        Returns
        -------
        Mask
            ``(N, n)`` True where the irradiance was 0 from the start, or less than half of a lamp
            is seen.
        """
        if self.body is None and not len(self.spheres) and not len(self.boxes):
            return light <= 0
        parts = lamps.shape[1]
        seen = np.zeros(light.shape, np.uint16)
        for part in range(parts):
            blocked = light <= 0
            toward = np.ascontiguousarray(lamps[:, part])
            if len(self.spheres) or len(self.boxes) or isinstance(self.body, HeightGrid):
                self._block(blocked, points_mm, solid, toward, near)
            if isinstance(self.body, TriangleTree):
                lifted = points_mm + _LIFT_MM * normals
                _block_by_mesh(self.body, blocked, lifted, solid, toward, near)
            seen += ~blocked
        light *= seen * np.float32(1 / parts)
        return np.asarray(2 * seen < parts, np.bool_)

    def _block(
        self, blocked: Bool, points: Float64, solid: Bool, lamps: Float64, near: bool
    ) -> None:
        origin, step = (0.0, 0.0), 1.0
        if isinstance(self.body, HeightGrid):
            origin, step = self.body.origin_xy_mm, self.body.step_mm
        in_threads(
            block,
            -(-len(points) // BLOCK),
            blocked,
            points,
            solid,
            lamps,
            near,
            # Contiguous in all cases: numba compiles a kernel for each layout of its arguments.
            np.ascontiguousarray(self.spheres),
            np.ascontiguousarray(self.boxes),
            self._heights.ravel(),
            self._heights.shape[1],
            self._tiles,
            origin[0],
            origin[1],
            step,
            float(self._tiles.max(initial=-math.inf)),
        )

    @cached_property
    def _heights(self) -> Float32:
        if isinstance(self.body, HeightGrid):
            return lowered(self.body)
        return np.zeros((0, 0), np.float32)

    @cached_property
    def _tiles(self) -> Float32:
        """Maximum of each tile of the grid."""
        heights = self._heights
        for axis in range(2):
            edges = np.arange(0, heights.shape[axis], TILE)
            if edges.size:
                heights = np.maximum.reduceat(heights, edges, axis=axis)
        return heights


def lowered(grid: HeightGrid) -> Float32:
    """Return heights whose interpolation is nowhere above the surface.

    The error of bilinear interpolation is at most an eighth of the sum of the second differences
    along x and y. Differences across a wall are excluded: the kernels place walls at their inner
    side.
    """
    # Importing it takes longer than rendering a small scene, and most scenes have no grid.
    from scipy.ndimage import maximum_filter, minimum_filter

    heights, wall = grid.heights_mm, WALL * grid.step_mm
    out = np.zeros_like(heights)
    rounding = _ROUNDING * max(1.0, float(np.abs(heights).max(initial=0.0)))
    for start in range(0, len(heights), _ROWS):
        low, high = max(0, start - 2), min(len(heights), start + _ROWS + 2)
        band = heights[low:high]
        bend = np.zeros_like(band)
        for axis in range(2):
            second = np.abs(np.diff(band, 2, axis=axis))
            second[second > wall] = 0
            inner = [slice(None), slice(None)]
            inner[axis] = slice(1, -1)
            bend[tuple(inner)] += second
        sag = maximum_filter(bend, 3) * np.float32(_SPARE / 8)
        # The surface between such uneven heights is unknown: only their minimum is safe.
        unresolved = sag > _UNRESOLVED * grid.step_mm
        sag[unresolved] = (band - minimum_filter(band, 3))[unresolved]
        stop = min(len(heights), start + _ROWS)
        part = slice(start - low, stop - low)
        out[start:stop] = band[part] - sag[part] - np.float32(rounding)
    return out


def _block_by_mesh(
    tree: TriangleTree, blocked: Bool, lifted: Float64, solid: Bool, lamps: Float64, near: bool
) -> None:
    for shaded, lamp in zip(blocked, lamps, strict=True):
        ask = np.flatnonzero(~shaded & solid)
        start = lifted[ask]
        way = lamp - start if near else np.broadcast_to(lamp, start.shape)
        shaded[ask] = tree.blocked(start, way, 1.0 if near else math.inf)
