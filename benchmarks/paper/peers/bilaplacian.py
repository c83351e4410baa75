"""Least squares of differential coordinates on a pixel grid, with the kernels of our multigrid.

With the graph Laplacian L of the grid, minimising |L u - c|^2 + a^2 |u|^2 requires
(L^2 + a^2) u = L c. Conjugate gradients in float64 solve this system. With the preconditioner
(L + a)^-2 they converge in a few steps, because its product with the matrix has eigenvalues in
1/2..1 only. Two V-cycles in float32 approximate this preconditioner. Their levels aggregate 2 x 2
pixels, as in `processing.surface.multigrid`. The term a makes the coarse levels well conditioned,
so that the coarsest level needs no exact solver.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

import processing.surface.multigrid_kernels as kernels
from processing.surface.grid_graph import apply_laplacian
from rig.arrays import Bool, Float32, Float64

# Smoothing sweeps before and after the coarse correction.
_SWEEPS = 2
# Below this number of pixels, threads cost more time than they save.
_SERIAL_PIXELS = 1 << 14
_COARSEST_PIXELS = 100
_MAX_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class _Level:
    right: Float32
    down: Float32
    screen: Float32
    inverse: Float32 = field(init=False)
    x: Float32 = field(init=False)
    b: Float32 = field(init=False)

    def __post_init__(self) -> None:
        diagonal = self.right + self.down + self.screen
        diagonal[:, 1:] += self.right[:, :-1]
        diagonal[1:] += self.down[:-1]
        inverse = np.divide(1, diagonal, out=np.zeros_like(diagonal), where=self.screen > 0)
        object.__setattr__(self, "inverse", inverse)
        for name in ("x", "b"):
            object.__setattr__(self, name, np.zeros_like(diagonal))

    @property
    def serial(self) -> bool:
        return self.right.size < _SERIAL_PIXELS

    def smooth(self, colours: tuple[int, ...]) -> None:
        relax = kernels.smooth_serial if self.serial else kernels.smooth
        for colour in colours:
            relax(self.right, self.down, self.inverse, self.b, self.x, colour)


class Bilaplacian:
    """The matrix L^2 + a^2 of one grid, with a solver for any right-hand side.

    Parameters
    ----------
    right, down
        ``(h+2, w+2)`` float32 edge weights of L with an empty border, as in
        `processing.surface.grid_graph`.
    inside
        ``(h+2, w+2)`` bool: the pixels whose values are unknown.
    anchor
        The number a, greater than 0.
    """

    def __init__(self, right: Float32, down: Float32, inside: Bool, anchor: float) -> None:
        self._anchor = anchor
        level = _Level(right, down, inside * np.float32(anchor))
        self._levels = [level]
        while level.right.size > _COARSEST_PIXELS:
            right, down = kernels.aggregate(level.right, level.down)
            level = _Level(right, down, _gathered(level.screen))
            self._levels.append(level)

    def apply(self, u: Float64, out: Float64) -> Float64:
        """Write the matrix times `u` into `out` and return L u."""
        finest = self._levels[0]
        once = np.zeros_like(u)
        apply_laplacian(finest.right, finest.down, u, once)
        apply_laplacian(finest.right, finest.down, once, out)
        out += self._anchor**2 * u
        return once

    def solve(self, b: Float64, start: Float64, tolerance: float) -> Float64:
        """Solve for u.

        Parameters
        ----------
        b
            ``(h+2, w+2)`` right-hand side, 0 outside the mask.
        start
            ``(h+2, w+2)`` initial guess of u.
        tolerance
            2-norm of the residual, relative to that of b, at which to stop.

        Raises
        ------
        ArithmeticError
            If the tolerance is not reached.
        """
        u, product = start.copy(), np.zeros_like(b)
        self.apply(u, product)
        residual, direction = b - product, np.zeros_like(b)
        gamma, least = 0.0, tolerance * math.sqrt(np.vdot(b, b))
        for iteration in range(_MAX_ITERATIONS):
            if math.sqrt(np.vdot(residual, residual)) <= least:
                return u
            self._cycle(residual)
            correction = self._cycle(self._levels[0].x)
            gamma, previous = float(kernels.dot(residual, correction).sum()), gamma
            kernels.add_scaled(direction, correction, gamma / previous if iteration else 0.0)
            once = self.apply(direction, product)
            curvature = float(np.vdot(once, once) + self._anchor**2 * np.vdot(direction, direction))
            kernels.step(u, residual, direction, product, gamma / curvature)
        raise ArithmeticError(f"no solution within {_MAX_ITERATIONS} iterations")

    def _cycle(self, residual: Float64 | Float32) -> Float32:
        """Return one V-cycle's solution of (L + a) x = residual: symmetric, positive."""
        levels = self._levels
        levels[0].b[...] = residual
        for fine, coarse in pairwise(levels):
            fine.x[...] = 0
            fine.smooth((0, 1) * _SWEEPS)
            restrict = kernels.restrict_serial if fine.serial else kernels.restrict
            # The kernel applies L only, so the screening term is subtracted from the right side.
            restrict(fine.right, fine.down, fine.b - fine.screen * fine.x, fine.x, coarse.b)
        last = levels[-1]
        last.x[...] = 0
        last.smooth((0, 1) * _SWEEPS + (1, 0) * _SWEEPS)
        for fine, coarse in zip(levels[-2::-1], levels[:0:-1], strict=True):
            prolong = kernels.prolong_serial if fine.serial else kernels.prolong
            prolong(coarse.x, fine.inverse, fine.x)
            # The reverse order of the colours makes the cycle symmetric.
            fine.smooth((1, 0) * _SWEEPS)
        return levels[0].x


def _gathered(screen: Float32) -> Float32:
    """Return a screening term summed over 2 x 2 pixels, as the kernels aggregate them."""
    inner = screen[1:-1, 1:-1]
    inner = np.pad(inner, [(0, length % 2) for length in inner.shape])
    sums = inner[::2, ::2] + inner[1::2, ::2] + inner[::2, 1::2] + inner[1::2, 1::2]
    return np.pad(sums, 1)
