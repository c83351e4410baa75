"""Joint adjustment of the placements of fields from registered pairs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rig import short_repr
from rig.arrays import Float64

# Pixels that are added to the standard deviations of a pair: its interpolation is not exact.
_MODEL_PX: Final = 0.01
# A pair is wrong if it is further from the others than this many standard deviations and pixels:
# lenses distort, and objects are not flat.
_WRONG, _WRONG_PX = 6.0, 1.0
# Pairs with the largest residuals, of which the wrong one is searched.
_SUSPECTS: Final = 8
_STEPS: Final = 8
_SETTLED_PX: Final = 1e-4


@dataclass(frozen=True, eq=False)
class FieldPair:
    """Two fields that show a common area.

    Parameters
    ----------
    first, second
        Numbers of the fields.
    matrix
        ``(3, 3)`` rigid transform from pixels of the first to those of the second.
    covariance
        ``(3, 3)`` of right, down and turn, in pixels at ``half_px`` from the middle.
    middle, half_px
        Middle (x, y) of the common area, and the root mean square distance from it, in pixels of
        the first field.
    correlation
        Of the fine structure in the common area.
    common_px
        Number of pixels of the common area.
    """

    first: int
    second: int
    matrix: Float64
    covariance: Float64
    middle: Float64
    half_px: float
    correlation: float
    common_px: int

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Placements that fit the pairs best.

    Parameters
    ----------
    placements
        ``(N, 3)``: right and down in pixels of the origin of each field, and its turn in radians
        from right to down; all 0 for the first field of the group.
    residuals_px
        Distance of the ends of each pair that is used, in pixels, by its number.
    deviations
        The same in standard deviations.
    rejected
        Numbers of pairs that contradict the others.
    """

    placements: Float64
    residuals_px: dict[int, float]
    deviations: dict[int, float]
    rejected: tuple[int, ...]


def matrix_of(placement: Float64) -> Float64:
    """Return the matrix ``(3, 3)`` of a placement (right, down, turn)."""
    right, down, turn = map(float, placement)
    cos, sin = math.cos(turn), math.sin(turn)
    return np.array([[cos, -sin, right], [sin, cos, down], [0, 0, 1]])


def groups_of(count: int, pairs: Iterable[FieldPair]) -> list[list[int]]:
    """Return the fields that pairs connect, group by group."""
    group = list(range(count))
    for pair in pairs:
        old, new = group[pair.second], group[pair.first]
        group = [new if one == old else one for one in group]
    return [[k for k in range(count) if group[k] == one] for one in dict.fromkeys(group)]


def adjust(count: int, pairs: Sequence[FieldPair]) -> Adjusted:
    """Return the placements of connected fields, without the pairs that contradict the others.

    Weighted least squares over all pairs. As long as a pair deviates too far, the one is removed
    without which the others agree best; a pair without which fields are not connected stays,
    because nothing contradicts it.

    Parameters
    ----------
    count
        Number of fields.
    pairs
        Pairs that connect all fields.
    """
    used, rejected = list(range(len(pairs))), list[int]()
    while True:
        placements, errors = _solve(count, [pairs[k] for k in used])
        deviations = np.sqrt((errors**2).mean(axis=1))
        residuals = np.array([_distance_px(pairs[k], placements) for k in used])
        if not ((deviations > _WRONG) & (residuals > _WRONG_PX)).any():
            break
        suspects = np.argsort(-deviations)[:_SUSPECTS]
        best, left = None, float((errors**2).sum())
        for suspect in suspects:
            others = [pairs[k] for number, k in enumerate(used) if number != suspect]
            if len(groups_of(count, others)) > 1:
                continue
            _, without = _solve(count, others)
            if (without**2).sum() < left:
                best, left = int(suspect), float((without**2).sum())
        if best is None:
            break
        rejected.append(used.pop(best))
    return Adjusted(
        placements,
        dict(zip(used, map(float, residuals), strict=True)),
        {k: float(one) for k, one in zip(used, deviations, strict=True)},
        tuple(rejected),
    )


def _distance_px(pair: FieldPair, placements: Float64) -> float:
    """Return the root mean square distance of the ends of a pair over its common area."""
    return float(np.linalg.norm(_differences(pair, placements)))


def _solve(count: int, pairs: Sequence[FieldPair]) -> tuple[Float64, Float64]:
    """Return placements ``(N, 3)`` and errors ``(E, 3)`` in standard deviations."""
    placements = _start(count, pairs)
    whiten = [
        np.linalg.inv(np.linalg.cholesky(one.covariance + _MODEL_PX**2 * np.eye(3)))
        for one in pairs
    ]
    for _ in range(_STEPS):
        matrix, right = np.zeros((3 * len(pairs), 3 * count)), np.zeros(3 * len(pairs))
        for row, (pair, white) in enumerate(zip(pairs, whiten, strict=True)):
            rows = slice(3 * row, 3 * row + 3)
            for field, by in _derivatives(pair, placements):
                matrix[rows, 3 * field : 3 * field + 3] = white @ by
            right[rows] = white @ _differences(pair, placements)
        step = np.zeros((count, 3))
        step[1:] = -np.linalg.lstsq(matrix[:, 3:], right, rcond=None)[0].reshape(-1, 3)
        placements = placements + step
        if np.abs(step).max(initial=0) < _SETTLED_PX:
            break
    errors = [
        white @ _differences(pair, placements) for pair, white in zip(pairs, whiten, strict=True)
    ]
    return placements, np.reshape(errors, (-1, 3))


def _start(count: int, pairs: Sequence[FieldPair]) -> Float64:
    """Return placements from the pairs with the largest common areas, one after the other."""
    matrices = {0: np.eye(3)}
    while len(matrices) < count:
        ready = [pair for pair in pairs if (pair.first in matrices) != (pair.second in matrices)]
        pair = max(ready, key=lambda one: one.common_px * one.correlation)
        if pair.first in matrices:
            matrices[pair.second] = matrices[pair.first] @ np.linalg.inv(pair.matrix)
        else:
            matrices[pair.first] = matrices[pair.second] @ pair.matrix
    found = [matrices[k] for k in range(count)]
    return np.array([[one[0, 2], one[1, 2], math.atan2(one[1, 0], one[0, 0])] for one in found])


def _differences(pair: FieldPair, placements: Float64) -> Float64:
    """Return right, down and turn from the first to the second end, as the covariance has them."""
    first, second = placements[pair.first], placements[pair.second]
    there = matrix_of(second) @ pair.matrix
    by = (there - matrix_of(first)) @ [*pair.middle, 1]
    turn = math.atan2(there[1, 0], there[0, 0]) - first[2]
    turn = math.remainder(turn, 2 * math.pi)
    cos, sin = math.cos(first[2]), math.sin(first[2])
    return np.array([cos * by[0] + sin * by[1], cos * by[1] - sin * by[0], turn * pair.half_px])


def _derivatives(pair: FieldPair, placements: Float64) -> list[tuple[int, Float64]]:
    """Return the derivatives of the differences by the placements of both fields."""
    made = []
    turn = placements[pair.first][2]
    back = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    here = np.array([*pair.middle, 1.0])
    for field, sign, point in (
        (pair.first, -1.0, here),
        (pair.second, 1.0, pair.matrix @ here),
    ):
        at = matrix_of(placements[field])[:2, :2] @ point[:2]
        by = np.zeros((3, 3))
        by[:2, :2] = sign * back
        by[:2, 2] = sign * back @ [-at[1], at[0]]
        by[2, 2] = sign * pair.half_px
        made.append((field, by))
    return made
