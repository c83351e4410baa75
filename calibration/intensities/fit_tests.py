"""Tests of a fit: whether the surface follows the model, and the card is where it should be."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtrit

from acquisition import Lights
from calibration.intensities.blocks import Blocks
from calibration.intensities.fit import Fit
from calibration.intensities.model import Geometry, NormalEquations
from rig import Notice

# A gloss or a shape that moves samples by 1 % moves intensities by nearly as much.
_POOR_FIT = 0.03
_SMOOTH_MISFIT = 0.01
# Positions that are all too high by 1 mm look like a card that is 1 mm too low, and positions from
# spheres have common errors of this size. 3 mm change intensities by .5 % in a dome of 450 mm.
_LEAST_MM = 3.0
_CONFIDENCE = 0.9999
_FEWEST_LIGHTS = 4
# LEDs are soldered to a few degrees. What turns an axis much farther than those of the other lights
# is a bent LED, or a position that is not that of the light.
_LEAST_DEG, _TYPICAL = 5.0, 6.0
_LISTED = 4


def doubts(fit: Fit, blocks: Blocks, lights: Lights) -> tuple[Notice, ...]:
    """Return what contradicts the model, at most one notice of each kind."""
    found = []
    residuals, *_ = fit.residuals()
    smooth = _smooth_misfit(np.where(np.isfinite(fit.values), residuals, np.nan), fit.scale)
    if fit.scale > _POOR_FIT or smooth > _SMOOTH_MISFIT:
        text = (
            f"the plane deviates from the model by {fit.scale:.1%}: check that it is matte and in "
            "the working plane"
        )
        found.append(Notice("plane-deviates", text))
    height = _height(fit, blocks, lights) if blocks.cards else None
    if height is not None:
        text = (
            f"the card is about {abs(height[0]):.1f} mm (standard deviation {height[1]:.1f}) "
            f"{'higher' if height[0] > 0 else 'lower'} than stated, or positions or axes of all "
            "lights are off alike: check the height of its upper side"
        )
        found.append(Notice("card-off-plane", text))
    return (*found, *_unlike(fit, lights))


def _unlike(fit: Fit, lights: Lights) -> list[Notice]:
    """Return a notice about lights whose axes are turned much farther than those of the others."""
    turned = np.degrees(np.arctan(np.hypot(*fit.tilt)))
    usual = float(np.median(turned))
    odd = np.flatnonzero(turned > max(_LEAST_DEG, _TYPICAL * usual))
    if not len(odd):
        return []
    listed = ", ".join(f"{lights.ids[k]} ({turned[k]:.0f} degrees)" for k in odd[:_LISTED])
    more = f" and {len(odd) - _LISTED} more" if len(odd) > _LISTED else ""
    text = (
        f"the images turn the axis of {listed}{more} away from the given one, those of half of the "
        f"lights by less than {max(usual, 0.1):.1f} degrees: unless this LED is bent, its position "
        "is wrong, or that of another light: check the order of wires and images"
    )
    return [Notice("axis-unlike", text)]


def _smooth_misfit(
    residuals: np.ndarray[tuple[int, ...], np.dtype[np.float64]], scale: float
) -> float:
    """Return the part of the residuals that neighbouring blocks share."""
    step = np.abs(np.diff(residuals, axis=2))
    noise = 1.4826 * float(np.nanmedian(step)) / np.sqrt(2) if np.isfinite(step).any() else scale
    return float(np.sqrt(max(scale**2 - noise**2, 0.0)))


def _height(fit: Fit, blocks: Blocks, lights: Lights) -> tuple[float, float] | None:
    """Return by how much cards are too high, and its standard deviation; None if they are not.

    A wrong height tilts the fitted axes of all lights in a pattern that is known. Its size is
    fitted to the tilts, whose other causes (real tilts, errors of positions) are its noise.
    """
    count = len(lights)
    if count < _FEWEST_LIGHTS or not fit.own_tilt.all():
        return None
    raised = Geometry.of(lights, blocks.points_mm + blocks.upward, blocks.normals)
    ratio, _ = fit.geometry.pattern(fit.tilt)
    higher, _ = raised.pattern(fit.tilt)
    slope = raised.fall_off - fit.geometry.fall_off + fit.mu[:, None] * (higher - ratio)
    residuals, weights, _, columns = fit.residuals()
    slope = np.where(np.isfinite(slope), slope, 0.0)
    equations = NormalEquations.of(residuals, weights, np.concatenate([columns, slope[None]]))
    size = fit.strength.size + 3 * count
    cross = equations.matrix[:size, size:].sum(axis=1)
    precision, _ = fit.prior()
    # The tilts that the fit finds if the card is 1 mm higher than stated.
    pattern = np.linalg.solve(equations.matrix[:size, :size] + precision, cross)[-2 * count :]
    tilts = fit.tilt.ravel()
    power = float(pattern @ pattern)
    height = float(pattern @ tilts) / power
    freedom = 2 * count - 1
    rest = float(np.sum((tilts - height * pattern) ** 2)) / freedom
    deviation = float(np.sqrt(rest / power))
    limit = float(stdtrit(freedom, (1 + _CONFIDENCE) / 2)) * deviation
    return (height, deviation) if abs(height) > max(limit, _LEAST_MM) else None
