"""What the overlaps of fields differ by: gains of their albedo, and tilts of their normals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from processing.merging.adjustment import FieldPair
from processing.merging.resampling import masked, turned
from processing.registration import Field
from processing.registration.normal_rotation import COMMON_PX, rotation_between
from rig import short_repr
from rig.arrays import Bool, Float64

# Tilts are corrected if they are this many times as large as what they should be by chance.
_SIGNIFICANT: Final = 3.0


@dataclass(frozen=True, eq=False)
class Differences:
    """What two fields differ by in their common area.

    Parameters
    ----------
    log_gain
        Median logarithm of the albedo of the second over that of the first; NaN without albedo.
    tilt
        ``(3,)`` rotation vector in radians by which the normals of the second are turned further
        than those of the first, in the axes of the first.
    covariance
        ``(3, 3)`` of the tilt.
    disagreement
        Root mean square difference of the normals in their standard deviations, without the tilt;
        NaN without standard deviations.
    """

    log_gain: float
    tilt: Float64
    covariance: Float64
    disagreement: float

    __repr__ = short_repr


def differences_of(first: Field, second: Field, matrix: Float64) -> Differences:
    """Return what two fields differ by.

    Parameters
    ----------
    first, second
        The fields.
    matrix
        ``(3, 3)`` rigid transform from pixels of the first to those of the second.
    """
    height, width = size = first.mask.shape
    there = second.normal_map
    normals = masked(there.normals, there.mask, matrix, size)
    normals = turned(normals, -math.atan2(matrix[1, 0], matrix[0, 0]))
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    x, y, _ = np.tensordot(matrix, np.stack([columns, rows, np.ones_like(rows)]), 1)
    inside = (x >= 0) & (y >= 0) & (x <= there.mask.shape[1] - 1) & (y <= there.mask.shape[0] - 1)
    length = np.linalg.norm(normals, axis=2)
    common = inside & first.mask & (length > 0.5)
    if np.count_nonzero(common) < COMMON_PX:
        return Differences(math.nan, np.zeros(3), np.eye(3), math.nan)
    a = first.normal_map.normals[common].astype(np.float64)
    b = normals[common] / length[common][:, None].astype(np.float64)
    tilt, covariance = rotation_between(a, b)
    left = ((b - np.cross(tilt, b) - a) ** 2).sum(axis=1)
    return Differences(
        _log_gain(first, second, matrix, common),
        tilt,
        covariance,
        _disagreement(first, second, matrix, common, left),
    )


def _log_gain(first: Field, second: Field, matrix: Float64, common: Bool) -> float:
    if first.albedo is None or second.albedo is None:
        return math.nan
    here = first.albedo[common]
    there = masked(second.albedo, second.mask, matrix, first.mask.shape)[common]
    known = (here > 0) & (there > 0)
    if not known.any():
        return math.nan
    return float(np.median(np.log(there[known].astype(np.float64) / here[known])))


def _disagreement(
    first: Field, second: Field, matrix: Float64, common: Bool, squares: Float64
) -> float:
    if first.sigma_deg is None or second.sigma_deg is None:
        return math.nan
    here = first.sigma_deg[common]
    there = masked(
        second.sigma_deg, second.mask & np.isfinite(second.sigma_deg), matrix, first.mask.shape
    )[common]
    variance = np.radians(here).astype(np.float64) ** 2 + np.radians(there) ** 2
    known = np.isfinite(variance) & (variance > 0)
    return float(np.sqrt((squares[known] / variance[known]).mean())) if known.any() else math.nan


def gains_of(count: int, pairs: Sequence[FieldPair], differences: Sequence[Differences]) -> Float64:
    """Return factors for the albedo of each field, with the geometric mean 1."""
    known = [k for k, one in enumerate(differences) if math.isfinite(one.log_gain)]
    matrix, right = np.zeros((len(known) + 1, count)), np.zeros(len(known) + 1)
    for row, k in enumerate(known):
        weight = math.sqrt(pairs[k].common_px)
        matrix[row, pairs[k].first], matrix[row, pairs[k].second] = -weight, weight
        right[row] = -weight * differences[k].log_gain
    matrix[-1] = 1
    return np.asarray(np.exp(np.linalg.lstsq(matrix, right, rcond=None)[0]), np.float64)


def tilts_of(
    turns: Float64,
    pairs: Sequence[FieldPair],
    differences: Sequence[Differences],
    common: Float64,
) -> Float64:
    """Return rotation vectors ``(N, 3)`` that make the normals of all fields agree.

    Their mean is 0. They are all 0 if the overlaps differ by no more than the standard deviations
    that the pixels of a field have in common, because such errors do not add up from field to
    field, as tilts would.

    Parameters
    ----------
    turns
        ``(N,)`` turn of each field in the whole, in radians from right to down.
    pairs, differences
        Pairs, and what their fields differ by.
    common
        ``(N,)`` those standard deviations in radians.
    """
    count = len(turns)
    matrix, right = np.zeros((3 * len(pairs) + 3, 3 * count)), np.zeros(3 * len(pairs) + 3)
    excess = []
    for row, (pair, one) in enumerate(zip(pairs, differences, strict=True)):
        variance = one.covariance + (
            common[pair.first] ** 2 + common[pair.second] ** 2
        ) / 2 * np.eye(3)
        white = np.linalg.inv(np.linalg.cholesky(variance))
        excess.append((white @ one.tilt)[:2])
        # In the axes of the whole, the difference of both corrections is the tilt.
        back = _turn_matrix(-turns[pair.first])
        rows = slice(3 * row, 3 * row + 3)
        matrix[rows, 3 * pair.first : 3 * pair.first + 3] = white @ back
        matrix[rows, 3 * pair.second : 3 * pair.second + 3] = -white @ back
        right[rows] = white @ one.tilt
    if not excess or np.sqrt(np.mean(np.square(excess))) < _SIGNIFICANT:
        return np.zeros((count, 3))
    matrix[-3:] = np.tile(np.eye(3), count)
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0].reshape(count, 3), np.float64)


def _turn_matrix(turn: float) -> Float64:
    """Return the rotation of normals when a field is turned from right to down."""
    cos, sin = math.cos(turn), math.sin(turn)
    return np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]])
