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
_FEWEST_PIXELS: Final = 500
_PARTS: Final = 8
_TUNING: Final = 2.0
_STEPS: Final = 12
_LONGEST_STEP_PX: Final = 2.0
_SETTLED_PX: Final = 0.0005
_RIDGE: Final = 1e-6
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

    def at(self, matrix: Float64, x: Float64, y: Float64) -> tuple[Float64, Bool]:
        """Return values ``(C, P)`` at transformed positions, and which of them are known."""
        right, down = transformed(matrix, x, y)
        where = np.stack([down, right])
        values = np.stack(
            [
                map_coordinates(one, where, order=3, prefilter=False, mode="mirror")
                for one in self._splines
            ]
        )
        return values.astype(np.float64), map_coordinates(self._known, where, order=1) > 0.999


def fit_placement(
    first: Float32, target: Target, start: Float64, model: PlaneModel
) -> PlacementFit | None:
    """Fit a placement of a structure ``(C, H, W)`` and a target from a start.

    Returns None if they have too little in common.
    """
    structure = fine(first, SMOOTH_PX)
    rows, columns = np.nonzero(_inner(first))
    common = target.at(start, np.asarray(columns, float), np.asarray(rows, float))[1]
    area = int(np.count_nonzero(common))
    if area < _FEWEST_PIXELS:
        return None
    rows, columns = rows[common], columns[common]
    middle = np.array([columns.mean(), rows.mean()])
    half = math.sqrt(float(columns.var() + rows.var()))
    # Changes right and down by central differences.
    right = (structure[:, rows, columns + 1] - structure[:, rows, columns - 1]).astype(float) / 2
    down = (structure[:, rows + 1, columns] - structure[:, rows - 1, columns]).astype(float) / 2
    seen = structure[:, rows, columns].astype(float)
    scales = 1.4826 * np.median(np.abs(seen), axis=1, keepdims=True) + 1e-12
    parts = _parts((columns - middle[0]) / half, (rows - middle[1]) / half)
    chosen = _strongest(((right**2 + down**2) / scales**2).sum(axis=0), parts)
    x, y = np.asarray(columns[chosen], float), np.asarray(rows[chosen], float)
    seen, parts = seen[:, chosen], parts[chosen]
    flow = velocities(model, (x - middle[0]) / half, (y - middle[1]) / half)
    # By each parameter, in pixels at the radius of the area: (C, P, K).
    jacobian = np.stack([right[:, chosen] * one[0] + down[:, chosen] * one[1] for one in flow], 2)
    frame = np.array([[1, 0, -middle[0]], [0, 1, -middle[1]], [0, 0, half]]) / half
    unframe, matrix = np.linalg.inv(frame), start
    for _ in range(_STEPS):
        values, usable = target.at(matrix, x, y)
        if np.count_nonzero(usable) < _FEWEST_PIXELS:
            return None
        values = turned_back(values, turn_of(matrix, *middle))
        residual = values - seen
        noise = 1.4826 * np.median(np.abs(residual[:, usable]), axis=1, keepdims=True) + 1e-12
        weights = usable / (1 + (residual / noise / _TUNING) ** 2) / noise**2
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
    both = np.clip(np.stack([values, seen])[:, :, usable] / scales, -_STRONG, _STRONG)
    power = np.square(both).sum(axis=(1, 2)) + 1e-30
    independent = area * np.count_nonzero(usable) / len(x) / (math.pi * SMOOTH_PX**2)
    return PlacementFit(
        matrix,
        model,
        _covariance(hessian, scores, parts),
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


def _covariance(hessian: Float64, scores: Float64, parts: Intp) -> Float64:
    """Return the covariance of the parameters from the scatter of scores between parts."""
    of_parts = np.zeros((_PARTS**2, len(hessian)))
    np.add.at(of_parts, parts, scores)
    used = of_parts[np.abs(of_parts).sum(axis=1) > 0]
    scatter = used - used.mean(axis=0)
    inverse = np.linalg.inv(hessian)
    return np.asarray(inverse @ (scatter.T @ scatter * len(used) / max(1, len(used) - 1)) @ inverse)


def _parts(u: Float64, v: Float64) -> Intp:
    """Return the number of the part of the common area in which points are."""
    cell = [np.clip((one + 2) / 4 * _PARTS, 0, _PARTS - 1).astype(np.intp) for one in (u, v)]
    return np.asarray(cell[1] * _PARTS + cell[0])


def _strongest(energy: Float64, parts: Intp) -> Intp:
    """Return the pixels with most structure of each part."""
    if len(energy) <= _MOST_PIXELS:
        return np.arange(len(energy))
    each = _MOST_PIXELS // len(np.unique(parts))
    order = np.lexsort((-energy, parts))
    rank = np.arange(len(energy)) - np.searchsorted(parts[order], parts[order])
    return np.sort(order[rank < each])
