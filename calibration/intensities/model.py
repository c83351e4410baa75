"""Logarithm of the irradiance from near lights, and its derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import Lights
from acquisition.values import tangent_basis
from rig.arrays import Float64


@dataclass(frozen=True, eq=False)
class Geometry:
    """K lights over P points: what does not depend on the radiation patterns.

    The pattern of light k is ``(cos t / cos t0)^mu`` (Queau et al., 2018), where t is the angle to
    its axis, here the given axis plus ``tilt[0] e1 + tilt[1] e2`` in the basis of
    `acquisition.values.tangent_basis`, and t0 the angle of the origin.

    Parameters
    ----------
    fall_off
        ``(K, P)`` logarithm of ``n.l / r^2``, relative to a surface at the origin that faces it.
    ahead
        ``(3, K, P)`` components along axis, e1 and e2 of the unit vectors to the points.
    origin
        ``(3, K)`` the same for the origin.
    """

    fall_off: Float64
    ahead: Float64
    origin: Float64

    @classmethod
    def of(cls, lights: Lights, points: Float64, normals: Float64) -> Geometry:
        """Return the geometry; samples that a light cannot reach are NaN."""
        position = np.asarray(lights.positions_mm)
        axes = np.asarray(lights.axes)
        frame = np.concatenate([axes[:, None], tangent_basis(axes)], axis=1)  # (K, 3, 3)
        toward = position[:, None] - points
        distance = np.linalg.norm(toward, axis=2)
        reference = np.linalg.norm(position, axis=1)
        facing = np.sum(toward * normals, axis=2) / distance
        fall_off = np.log(np.where(facing > 0, facing, np.nan))
        fall_off -= 2 * np.log(distance / reference[:, None])
        ahead = -np.einsum("kpi,kji->jkp", toward / distance[..., None], frame)
        origin = -np.einsum("ki,kji->jk", position / reference[:, None], frame)
        return cls(fall_off, ahead, origin)

    def pattern(self, tilt: Float64) -> tuple[Float64, Float64]:
        """Return ``log(cos t / cos t0)`` ``(K, P)`` and its derivatives by the tilts ``(2, K, P)``.

        The length of the tilted axis cancels in the ratio.
        """
        cosine = self.ahead[0] + np.einsum("jk,jkp->kp", tilt, self.ahead[1:])
        at_origin = self.origin[0] + np.sum(tilt * self.origin[1:], axis=0)
        cosine = np.where(cosine > 1e-3, cosine, np.nan)
        ratio = np.log(cosine / at_origin[:, None])
        slope = self.ahead[1:] / cosine - (self.origin[1:] / at_origin)[..., None]
        return ratio, slope


def position_slopes(lights: Lights, points: Float64, normals: Float64) -> Float64:
    """Return the derivatives of the logarithm by the positions, ``(3, K, P)`` per mm.

    The axes stay parallel.
    """
    position, axes = np.asarray(lights.positions_mm), np.asarray(lights.axes)
    toward = position[:, None] - points
    square = np.sum(toward**2, axis=2, keepdims=True)
    home = np.sum(position**2, axis=1)[:, None, None]
    mu = np.asarray(lights.mu)[:, None, None]
    slope = normals / np.sum(toward * normals, axis=2, keepdims=True) - 3 * toward / square
    slope = slope + 2 * position[:, None] / home
    along = np.sum(toward * axes[:, None], axis=2, keepdims=True)
    along_home = np.sum(position * axes, axis=1)[:, None, None]
    slope = slope + mu * (axes[:, None] / along - toward / square)
    slope = slope - mu * (axes[:, None] / along_home - position[:, None] / home)
    return np.moveaxis(slope, 2, 0)


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Weighted least squares for C channels, K lights and columns shared by the channels.

    Unknown ``c * K + k`` is the strength of light k in channel c; ``C * K + j * K + k`` is column j
    of light k.

    Parameters
    ----------
    matrix
        ``(n, n)``.
    right
        ``(n,)``.
    scores
        ``(n, P)`` contributions of the blocks to `right`; None if they were not requested.
    """

    matrix: Float64
    right: Float64
    scores: Float64 | None

    @classmethod
    def of(
        cls, residuals: Float64, weights: Float64, columns: Float64, *, scores: bool = False
    ) -> NormalEquations:
        """Build them from residuals and weights ``(C, K, P)`` and columns ``(J, K, P)``."""
        channels, lights, blocks = residuals.shape
        width = 1 + len(columns)
        size = (channels + width - 1) * lights
        matrix, right = np.zeros((size, size)), np.zeros(size)
        found = np.zeros((size, blocks)) if scores else None
        extended = np.concatenate([np.ones((1, lights, blocks)), columns])
        for c in range(channels):
            weight, residual = weights[c], residuals[c]
            total = weight.sum(axis=0)
            total = np.where(total > 0, total, 1.0)
            loaded = extended * weight
            flat = loaded.reshape(width * lights, blocks)
            block = -((flat / total) @ flat.T)
            for k in range(lights):
                own = np.ix_(np.arange(width) * lights + k, np.arange(width) * lights + k)
                block[own] += loaded[:, k] @ extended[:, k].T
            rest = residual - (weight * residual).sum(axis=0) / total
            score = (loaded * rest).reshape(width * lights, blocks)
            place = np.concatenate(
                [
                    c * lights + np.arange(lights),
                    channels * lights + np.arange((width - 1) * lights),
                ]
            )
            matrix[np.ix_(place, place)] += block
            right[place] += score.sum(axis=1)
            if found is not None:
                found[place] += score
        return cls(matrix, right, found)
