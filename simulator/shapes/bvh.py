"""Ray-triangle intersection with a bounding volume hierarchy and its two searches.

Triangles are tested in a sheared frame of the ray. In this frame, the signs at a shared edge are
exact opposites, so no ray passes between two neighbours (Woop, Benthin, Wald, Watertight
ray/triangle intersection, JCGT 2013).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numba
import numpy as np

from rig import in_threads
from rig.arrays import Bool, Float64, Int32
from rig.kernels import PART
from simulator.shapes.bvh_growth import STACK, grow

# Compiled in: rig/kernels/parts.py 986f6e8c38a7


@dataclass(frozen=True, eq=False)
class TriangleTree:
    """Triangles in the order of their tree.

    All triangles of node k are within ``bounds[k]``. ``count[k] > 0`` marks a leaf with the
    triangles ``first[k] ... first[k] + count[k] - 1``. The children of any other node are k + 1
    and ``first[k]``; ``axis[k]`` is the axis along which k + 1 is the lower child.

    Parameters
    ----------
    corners
        ``(F, 3, 3)``: triangle, corner, x y z.
    faces
        ``(F,)`` index of each triangle in the array from which the tree was built.
    bounds
        ``(nodes, 6)``: low x y z, high x y z, widened by rounding errors.
    first, count, axis
        ``(nodes,)``, see above.
    """

    corners: Float64
    faces: Int32
    bounds: Float64
    first: Int32
    count: Int32
    axis: Int32

    @classmethod
    def grow(cls, corners: Float64) -> Self:
        """Build the tree of triangles with finite corners ``(F, 3, 3)``, F at least 1."""
        total = len(corners)
        low, high = corners.min(axis=1), corners.max(axis=1)
        order = np.arange(total, dtype=np.int32)
        bounds = np.zeros((2 * total, 6))
        first, count, axis = (np.zeros(2 * total, np.int32) for _ in range(3))
        nodes = grow(low, high, order, bounds, first, count, axis)
        bounds = bounds[:nodes]
        # If a box were as thin as its triangle, rays would miss it by rounding errors.
        slack = 1e-12 * max(float(np.abs(bounds).max()), 1e-300)
        bounds[:, :3] -= slack
        bounds[:, 3:] += slack
        return cls(
            np.ascontiguousarray(corners[order]),
            order,
            np.ascontiguousarray(bounds),
            first[:nodes].copy(),
            count[:nodes].copy(),
            axis[:nodes].copy(),
        )

    def closest(self, origins: Float64, directions: Float64) -> tuple[Float64, Float64, Int32]:
        """Find the first triangle on each ray.

        Parameters
        ----------
        origins, directions
            ``(n, 3)``; a ray is ``origin + t * direction`` with t > 0.

        Returns
        -------
        t, weights, face
            ``(n,)`` t of the hit, inf if there is no hit; ``(n, 3)`` barycentric weights of the
            triangle's corners; ``(n,)`` index in the array from which the tree was built, -1 if
            there is no hit.
        """
        count = len(origins)
        t, weights = np.full(count, np.inf), np.zeros((count, 3))
        face = np.full(count, -1, np.int32)
        in_threads(
            _closest,
            len(origins),
            np.ascontiguousarray(origins, np.float64),
            np.ascontiguousarray(directions, np.float64),
            self._arrays,
            STACK,
            t,
            weights,
            face,
        )
        return t, weights, np.where(face >= 0, self.faces[face], -1).astype(np.int32)

    def blocked(self, origins: Float64, directions: Float64, reach: float = 1.0) -> Bool:
        """Find which rays hit any triangle before they end.

        Parameters
        ----------
        origins
            ``(n, 3)`` points. Points on the mesh must be lifted off it, or they may be blocked by
            their own triangles.
        directions
            ``(n, 3)`` vectors to the lamp; with ``reach`` 1, the ray ends there.
        reach
            End of the rays in units of ``directions``; inf for distant lights.

        Returns
        -------
        NDArray
            ``(n,)`` True if there is a hit at 0 < t < reach.
        """
        hit = np.zeros(len(origins), np.bool_)
        in_threads(
            _any,
            len(origins),
            np.ascontiguousarray(origins, np.float64),
            np.ascontiguousarray(directions, np.float64),
            self._arrays,
            STACK,
            float(reach),
            hit,
        )
        return hit

    @property
    def _arrays(self) -> Tree:
        return self.corners, self.bounds, self.first, self.count, self.axis


Tree = tuple[Float64, Float64, Int32, Int32, Int32]


@numba.njit(**PART, error_model="numpy")
def _search(
    origin: Float64, direction: Float64, tree: Tree, reach: float, any_will_do: bool, stack: Int32
) -> tuple[float, int, float, float]:
    """Return t, index of the triangle (-1: no hit) and weights of its first two corners."""
    corners, bounds, first, count, axis = tree
    # Frame of the ray: z along its largest component, x and y sheared so that the ray is on z.
    kz = 0
    for c in range(1, 3):
        if abs(direction[c]) > abs(direction[kz]):
            kz = c
    kx, ky = (kz + 1) % 3, (kz + 2) % 3
    scale = 1.0 / direction[kz]
    shear_x, shear_y = direction[kx] * scale, direction[ky] * scale
    ox, oy, oz = origin[kx], origin[ky], origin[kz]
    inverse = (1.0 / direction[0], 1.0 / direction[1], 1.0 / direction[2])
    best, found, u_best, v_best = reach, -1, 0.0, 0.0
    stack[0] = 0
    waiting = 1
    while waiting:
        waiting -= 1
        node = stack[waiting]
        enter, leave = 0.0, best
        for c in range(3):
            near = (bounds[node, c] - origin[c]) * inverse[c]
            far = (bounds[node, c + 3] - origin[c]) * inverse[c]
            if inverse[c] < 0.0:
                near, far = far, near
            # A component of 0 gives inf, or nan exactly on the face of a slab. Comparisons with
            # nan are false, which keeps the box.
            if near > enter:
                enter = near
            if far < leave:
                leave = far
        if enter > leave * (1.0 + 1e-14):
            continue
        if count[node] == 0:
            low_first = direction[axis[node]] >= 0.0
            stack[waiting] = first[node] if low_first else node + 1
            stack[waiting + 1] = node + 1 if low_first else first[node]
            waiting += 2
            continue
        for k in range(first[node], first[node] + count[node]):
            az, bz, cz = corners[k, 0, kz] - oz, corners[k, 1, kz] - oz, corners[k, 2, kz] - oz
            ax = corners[k, 0, kx] - ox - shear_x * az
            ay = corners[k, 0, ky] - oy - shear_y * az
            bx = corners[k, 1, kx] - ox - shear_x * bz
            by = corners[k, 1, ky] - oy - shear_y * bz
            cx = corners[k, 2, kx] - ox - shear_x * cz
            cy = corners[k, 2, ky] - oy - shear_y * cz
            u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
            if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
                continue
            whole = u + v + w
            if whole == 0.0:
                continue
            t = (u * az + v * bz + w * cz) * scale / whole
            if 0.0 < t < best:
                best, found, u_best, v_best = t, k, u / whole, v / whole
                if any_will_do:
                    return best, found, u_best, v_best
    return best, found, u_best, v_best


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _closest(
    first: int,
    last: int,
    origins: Float64,
    directions: Float64,
    tree: Tree,
    depth: int,
    t: Float64,
    weights: Float64,
    face: Int32,
) -> None:
    stack = np.zeros(depth, np.int32)
    for i in range(first, last):
        at, k, u, v = _search(origins[i], directions[i], tree, math.inf, False, stack)
        if k >= 0:
            t[i], face[i] = at, k
            weights[i, 0], weights[i, 1], weights[i, 2] = u, v, 1.0 - u - v


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _any(
    first: int,
    last: int,
    origins: Float64,
    directions: Float64,
    tree: Tree,
    depth: int,
    reach: float,
    found: Bool,
) -> None:
    stack = np.zeros(depth, np.int32)
    for i in range(first, last):
        found[i] = _search(origins[i], directions[i], tree, reach, True, stack)[1] >= 0
