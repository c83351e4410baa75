"""Smooth shifts that a plane transform leaves: parallax of a relief, distortion of a lens."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import block_diag, csr_array, diags_array, eye_array, kron
from scipy.sparse.linalg import splu

from processing.registration.placement_fit import (
    INTERPOLATION_PX,
    Comparison,
    PlacementFit,
    Target,
    turned_back,
)
from processing.registration.plane_transform import transformed, turn_of
from rig.arrays import Float64

# Distance of the nodes, and standard deviations of a shift and of the difference of neighbours.
_SPACING_PX: Final = 64
_PRIOR_PX: Final = 1.0
_NEIGHBOURS_PX: Final = 0.1
_STEPS: Final = 6
# Blocks of pixels whose errors are independent.
_BLOCK_PX: Final = 16
# A drift counts if it explains more than chance does by this many deviations.
_LEAST_SIGNIFICANCE: Final = 5.0


@dataclass(frozen=True, eq=False)
class Drift:
    """Shifts in pixels of the first field, linear between nodes.

    Parameters
    ----------
    nodes
        ``(2, h, w)`` shifts right and down; a node is at the middle of each 64 x 64 pixels.
    sigma_px
        Standard deviation of a shift, both axes together, root mean square over the nodes.
    """

    nodes: Float64
    sigma_px: float

    def at(self, x: Float64, y: Float64) -> Float64:
        """Return the shifts ``(2, P)`` at positions in the first field."""
        where = np.stack([(y + 0.5) / _SPACING_PX - 0.5, (x + 0.5) / _SPACING_PX - 0.5])
        return np.stack(
            [map_coordinates(one, where, order=1, mode="nearest") for one in self.nodes]
        )


def fit_drift(
    compared: Comparison, target: Target, fit: PlacementFit, size: tuple[int, int]
) -> Drift | None:
    """Fit the drift that a placement leaves; None if chance explains it.

    Parameters
    ----------
    compared, target
        What is compared.
    fit
        The placement.
    size
        Rows and columns of the first field.
    """
    rows, columns = (-(-length // _SPACING_PX) for length in size)
    x, y, turn = compared.x, compared.y, turn_of(fit.matrix, *fit.middle)
    node = (y // _SPACING_PX).astype(int) * columns + (x // _SPACING_PX).astype(int)
    smooth = _smoothness(rows, columns)
    count, slopes = rows * columns, (compared.right, compared.down)
    nodes = np.zeros((2, count))
    for step in range(_STEPS):
        right, down = Drift(nodes.reshape(2, rows, columns), 0.0).at(x, y)
        values, usable = target.at(*transformed(fit.matrix, x + right, y + down))
        residual = turned_back(values, turn) - compared.seen
        if step == 0:
            before, seen = residual, usable
        weights = compared.weights(residual, usable & seen)
        weights /= _excess(compared, weights, residual)
        pull = np.stack([(slope * weights * residual).sum(axis=0) for slope in slopes])
        products = [(a * weights * b).sum(axis=0) for a in slopes for b in slopes]
        blocks = np.stack([np.bincount(node, one, count) for one in products], axis=1)
        pulls = np.stack([np.bincount(node, one, count) for one in pull], axis=1)
        information = csr_array(block_diag(list(blocks.reshape(-1, 2, 2))))
        factor = splu((information + smooth).tocsc())
        change = factor.solve(-pulls.ravel() - smooth @ nodes.T.ravel())
        nodes = nodes + change.reshape(-1, 2).T
    gained = float((weights * (before**2 - residual**2)).sum())
    # Each parameter takes its share of chance: trace of (information + smooth)^-1 information.
    probe = np.random.default_rng(1).choice([-1.0, 1.0], (nodes.size, 20))
    solved = factor.solve(probe)
    chance = float((probe * (information @ solved)).sum(axis=0).mean())
    if gained < chance + _LEAST_SIGNIFICANCE * math.sqrt(2 * max(chance, 1.0)):
        return None
    measured = blocks.any(axis=1)
    if math.sqrt(2 * float((nodes[:, measured] ** 2).mean())) < INTERPOLATION_PX:
        return None
    variance = 2 * float((probe * solved)[measured.repeat(2)].mean())
    return Drift(nodes.reshape(2, rows, columns), math.sqrt(variance))


def _excess(compared: Comparison, weights: Float64, residual: Float64) -> float:
    """Return by how much blocks of pixels scatter more than independent pixels, at least 1."""
    blocks = [(one // _BLOCK_PX).astype(np.intp) for one in (compared.y, compared.x)]
    block = blocks[0] * (int(blocks[1].max()) + 1) + blocks[1]
    scatter, expected = 0.0, 0.0
    for slope in (compared.right, compared.down):
        pull = np.bincount(block, (slope * weights * residual).sum(axis=0))
        scatter += float((pull**2).sum())
        expected += float((slope**2 * weights).sum())
    return max(1.0, scatter / expected)


def _smoothness(rows: int, columns: int) -> csr_array:
    """Return the inverse covariance of the nodes before they are measured."""
    one = [
        diags_array([1.0, -1.0], offsets=[0, 1], shape=(length - 1, length))
        for length in (rows, columns)
    ]
    along, across = (d.T @ d for d in one)
    laplacian = kron(along, eye_array(columns)) + kron(eye_array(rows), across)
    prior = laplacian / _NEIGHBOURS_PX**2 + eye_array(rows * columns) / _PRIOR_PX**2
    return csr_array(kron(prior, eye_array(2)))
