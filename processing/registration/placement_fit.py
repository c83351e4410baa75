"""Fit of a placement: a plane transform that maps one field to another, to hundredths of a pixel.

The first field is compared with the second at the transformed positions (inverse compositional
Gauss-Newton, Baker and Matthews, 2004). What is compared is fine structure of slopes, which turn
with the object, and of the albedo; neither depends on the lights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from processing.registration.field import fine
from processing.registration.plane_transform import (
    PlaneModel,
    small_transform,
    transformed,
    turn_of,
    velocities,
)
from rig.arrays import Bool, Float32, Float64, Intp

# Structure wider than this is not compared.
SMOOTH_PX: Final = 4.0
_BORDER_PX: Final = 4
# Pixels that are compared: those with most structure in each part of the common area.
_MOST_PIXELS: Final = 60_000
FEWEST_PIXELS: Final = 500
_PARTS: Final = 8
_TUNING: Final = 2.0
_STEPS: Final = 12
_LONGEST_STEP_PX: Final = 2.0
_SETTLED_PX: Final = 0.0005
# Correlation of fine structure in units of its deviation between unrelated fields: chance is 3.
_LEAST_SIGNIFICANCE: Final = 6.0
# Error of positions without noise.
INTERPOLATION_PX: Final = 0.0005
_RIDGE: Final = 1e-6
# Least residual relative to the structure.
_EXACT: Final = 1e-4
# Larger values count as this many deviations in the correlation.
_STRONG: Final = 4.0


@dataclass(frozen=True, eq=False)
class PlacementFit:
    """A fitted placement.

    Parameters
    ----------
    matrix
        ``(3, 3)`` from pixels of the first structure to those of the second.
    model
        What is fitted.
    covariance
        ``(P, P)`` of the parameters of the model, in pixels of the first at the distance `half`
        from the middle; from the scatter between parts of the common area.
    middle, half
        Middle ``(x, y)`` of the common area and its root mean square radius, in pixels.
    correlation
        Correlation of the fine structure.
    independent
        Number of places whose structure is independent.
    """

    matrix: Float64
    model: PlaneModel
    covariance: Float64
    middle: Float64
    half: float
    correlation: float
    independent: float

    @property
    def credible(self) -> bool:
        """Whether the correlation is larger than between unrelated fields."""
        return self.correlation * math.sqrt(self.independent) > _LEAST_SIGNIFICANCE

    def sigma_px(self, x: Float64, y: Float64) -> Float64:
        """Return standard deviations ``(P,)`` of positions, both axes together."""
        flow = velocities(
            self.model, (x - self.middle[0]) / self.half, (y - self.middle[1]) / self.half
        )
        return np.asarray(np.sqrt(np.einsum("kcp,kl,lcp->p", flow, self.covariance, flow)))


class Target:
    """The second structure, for values between its pixels."""

    def __init__(self, structure: Float32) -> None:
        made = fine(structure, SMOOTH_PX)
        self._splines = [spline_filter(one, order=3, output=np.float32) for one in made]
        self._known = _inner(structure).astype(np.float32)

    def at(self, x: Float64, y: Float64) -> tuple[Float64, Bool]:
        """Return values ``(C, P)`` at positions, and which of them are known."""
        where = np.stack([y, x])
        values = np.stack(
            [
                map_coordinates(one, where, order=3, prefilter=False, mode="mirror")
                for one in self._splines
            ]
        )
        return values.astype(np.float64), map_coordinates(self._known, where, order=1) > 0.999


@dataclass(frozen=True, eq=False)
class Comparison:
    """Pixels ``(P,)`` of the first structure that are compared, with their values.

    Parameters
    ----------
    x, y
        Their positions.
    seen, right, down
        ``(C, P)`` fine structure, and its changes right and down.
    scales
        ``(C, 1)`` usual size of the fine structure.
    area
        Number of pixels in common, of which these have most structure.
    """

    x: Float64
    y: Float64
    seen: Float64
    right: Float64
    down: Float64
    scales: Float64
    area: int

    @classmethod
    def of(cls, first: Float32, target: Target, start: Float64) -> Comparison | None:
        """Choose pixels of a structure ``(C, H, W)``; None if too few are in common."""
        structure = fine(first, SMOOTH_PX)
        rows, columns = np.nonzero(_inner(first))
        common = target.at(*transformed(start, columns.astype(float), rows.astype(float)))[1]
        area = int(np.count_nonzero(common))
        if area < FEWEST_PIXELS:
            return None
        rows, columns = rows[common], columns[common]
        seen = structure[:, rows, columns].astype(float)
        scales = 1.4826 * np.median(np.abs(seen), axis=1, keepdims=True) + 1e-12
        # By central differences.
        right = (structure[:, rows, columns + 1] - structure[:, rows, columns - 1]) / 2.0
        down = (structure[:, rows + 1, columns] - structure[:, rows - 1, columns]) / 2.0
        x, y = np.asarray(columns, float), np.asarray(rows, float)
        chosen = _strongest(((right**2 + down**2) / scales**2).sum(axis=0), y, x)
        return cls(
            x[chosen],
            y[chosen],
            seen[:, chosen],
            np.asarray(right[:, chosen], float),
            np.asarray(down[:, chosen], float),
            scales,
            area,
        )

    def weights(self, residual: Float64, usable: Bool) -> Float64:
        """Return reciprocal variances of residuals ``(C, P)``, robustly."""
        noise = 1.4826 * np.median(np.abs(residual[:, usable]), axis=1, keepdims=True)
        noise = noise + _EXACT * self.scales
        return np.asarray(usable / (1 + (residual / noise / _TUNING) ** 2) / noise**2)


def fit_placement(
    compared: Comparison, target: Target, start: Float64, model: PlaneModel
) -> PlacementFit | None:
    """Fit a placement from a start; None if too few pixels stay in common."""
    x, y = compared.x, compared.y
    middle = np.array([x.mean(), y.mean()])
    half = math.sqrt(float(x.var() + y.var()))
    flow = velocities(model, (x - middle[0]) / half, (y - middle[1]) / half)
    # By each parameter, in pixels at the radius of the area: (C, P, K).
    jacobian = np.stack([compared.right * one[0] + compared.down * one[1] for one in flow], 2)
    frame = np.array([[1, 0, -middle[0]], [0, 1, -middle[1]], [0, 0, half]]) / half
    unframe, matrix = np.linalg.inv(frame), start
    for _ in range(_STEPS):
        values, usable = target.at(*transformed(matrix, x, y))
        if np.count_nonzero(usable) < FEWEST_PIXELS:
            return None
        values = turned_back(values, turn_of(matrix, *middle))
        residual = values - compared.seen
        weights = compared.weights(residual, usable)
        hessian = np.einsum("cpk,cp,cpl->kl", jacobian, weights, jacobian)
        hessian += _RIDGE * np.trace(hessian) / len(hessian) * np.eye(len(hessian))
        scores = (jacobian * (weights * residual)[..., None]).sum(axis=0)
        step = np.linalg.solve(hessian, scores.sum(axis=0))
        largest = float(np.abs(step).max())
        step *= min(1.0, _LONGEST_STEP_PX / max(largest, 1e-12))
        matrix = matrix @ unframe @ small_transform(-step / half) @ frame
        matrix = matrix / matrix[2, 2]
        if largest < _SETTLED_PX:
            break
    both = np.stack([values, compared.seen])[:, :, usable] / compared.scales
    both = np.clip(both, -_STRONG, _STRONG)
    power = np.square(both).sum(axis=(1, 2)) + 1e-30
    independent = compared.area * np.count_nonzero(usable) / len(x) / (math.pi * SMOOTH_PX**2)
    parts = _parts(y, x)
    of_parts = np.zeros((_PARTS**2, len(hessian)))
    np.add.at(of_parts, parts, scores)
    used = of_parts[np.bincount(parts, minlength=_PARTS**2) > 0]
    scatter = used - used.mean(axis=0)
    inverse = np.linalg.inv(hessian)
    between = scatter.T @ scatter * len(used) / max(1, len(used) - 1)
    return PlacementFit(
        matrix,
        model,
        inverse @ between @ inverse,
        middle,
        half,
        float((both[0] * both[1]).sum() / np.sqrt(power.prod())),
        independent,
    )


def _inner(structure: Float32) -> Bool:
    """Return the known pixels whose fine structure has known surroundings on all sides."""
    known = np.asarray(np.isfinite(structure).all(axis=0), np.uint8)
    wide = np.ones((2 * _BORDER_PX + 1, 2 * _BORDER_PX + 1), np.uint8)
    return np.asarray(cv2.erode(known, wide, borderValue=0) > 0)


def turned_back(values: Float64, turn: float) -> Float64:
    """Return slopes (right, up) of the second field in the axes of the first."""
    made = values.copy()
    c, s = math.cos(turn), math.sin(turn)
    # A turn from right to down is one from up to right.
    made[0] = c * values[0] - s * values[1]
    made[1] = s * values[0] + c * values[1]
    return made


def _parts(rows: Float64, columns: Float64) -> Intp:
    """Return the number of the part of the common area in which pixels are."""
    cells = []
    for one in (rows, columns):
        low, high = float(one.min()), float(one.max()) + 1
        cells.append(((one - low) / (high - low) * _PARTS).astype(np.intp))
    return np.asarray(cells[0] * _PARTS + cells[1])


def _strongest(energy: Float64, rows: Float64, columns: Float64) -> Intp:
    """Return the pixels with most structure of each part."""
    if len(energy) <= _MOST_PIXELS:
        return np.arange(len(energy))
    parts = _parts(rows, columns)
    each = _MOST_PIXELS // len(np.unique(parts))
    order = np.lexsort((-energy, parts))
    rank = np.arange(len(energy)) - np.searchsorted(parts[order], parts[order])
    return np.sort(order[rank < each])
