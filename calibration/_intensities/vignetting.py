"""Vignetting from the fitted albedo of an even surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration._intensities.blocks import Blocks
from calibration._intensities.fit import Fit
from calibration._intensities.surface import Array
from rig import short_repr

_ROUNDS = 10


@dataclass(frozen=True)
class Vignetting:
    """Brightness of an evenly lit image, ``1 + a r^2 + b r^4`` in its logarithm.

    Parameters
    ----------
    coefficients
        a and b, where r is the distance from the middle of the image relative to its corner.
    corner
        Brightness of a corner relative to the middle; 1 without vignetting.
    corner_std
        Standard deviation of `corner`.
    """

    coefficients: tuple[float, float]
    corner: float
    corner_std: float

    __repr__ = short_repr


def fit_vignetting(fit: Fit, blocks: Blocks, covariance: Array) -> Vignetting:
    """Fit a radial fall to the albedo of surfaces of even albedo.

    Linear gradients are fitted as well and left out, because the tilts of all lights together
    look like one.

    Parameters
    ----------
    fit
        A fit that has run; the mean over its channels is used.
    blocks
        The blocks it was fitted to.
    covariance
        Of its unknowns.
    """
    _, weights, _, columns = fit.residuals()
    surfaces = blocks.part[:, None] == np.unique(blocks.part)
    size = np.ptp(blocks.points_mm[:, :2], axis=0).max()
    design = np.concatenate(
        [
            np.stack([blocks.radius**2, blocks.radius**4], axis=1),
            blocks.points_mm[:, :2] / size,
            surfaces,
        ],
        axis=1,
    )
    albedo = fit.albedo.mean(axis=0)
    robust = np.ones(len(albedo))
    for _ in range(_ROUNDS):
        inverse = np.linalg.pinv((design * robust[:, None]).T @ design)
        found = inverse @ (design.T @ (robust * albedo))
        rest = albedo - design @ found
        scale = max(1.4826 * float(np.median(np.abs(rest))), 1e-9)
        robust = 1 / (1 + (rest / (2.385 * scale)) ** 2)
    gain = inverse @ (design * robust[:, None]).T
    noise = (gain * rest**2) @ gain.T
    shift = shift_by_lights(fit, weights, columns, gain)
    total = noise + shift @ covariance @ shift.T
    fall = float(found[0] + found[1])
    deviation = float(np.sqrt(total[:2, :2].sum()))
    corner = float(np.exp(fall))
    return Vignetting((float(found[0]), float(found[1])), corner, corner * deviation)


def shift_by_lights(fit: Fit, weights: Array, columns: Array, gain: Array) -> Array:
    """Return the derivatives of linear figures of the albedo by the unknowns of the lights.

    An error of the lights changes the logarithm of the albedo by the weighted mean of the columns,
    negated.

    Parameters
    ----------
    fit
        A fit that has run.
    weights, columns
        As `Fit.residuals` returns them.
    gain
        ``(F, P)`` derivatives of F figures by the mean logarithm of the albedo over the channels.

    Returns
    -------
    NDArray
        ``(F, n)`` for the n unknowns in the order of `NormalEquations`.
    """
    channels, lights = fit.strength.shape
    shift = np.zeros((len(gain), (channels + len(columns)) * lights))
    for c in range(channels):
        share = weights[c] / np.maximum(weights[c].sum(axis=0), 1e-300) / channels
        shift[:, c * lights : (c + 1) * lights] = -gain @ share.T
        for j, column in enumerate(columns):
            place = slice((channels + j) * lights, (channels + j + 1) * lights)
            shift[:, place] -= gain @ (share * column).T
    return shift
