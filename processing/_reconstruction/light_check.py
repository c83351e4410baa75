"""Comparison of the given lights with those that the images themselves show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from processing._reconstruction.samples import Samples
from processing._reconstruction.self_calibration import (
    Factors,
    align,
    angles_deg,
    explained,
    factorise,
)
from processing._reconstruction.under_lights import relative_residual
from rig import Notice, short_repr

Double = npt.NDArray[np.float64]

# With fewer images, three of them determine the map between found and given lights, and the others
# hardly check it.
_FEWEST_CHECKED = 8
_FEWEST_IMAGES = 5
_FEWEST_PIXELS = 100
# The third component of the images, as a fraction of a sample: .05 is a relief whose normals
# vary by about 8 degrees. Flatter objects do not show where the lights are; a wrong falloff of near
# lights alone reaches .02.
_LEAST_RELIEF = 0.04
# The same component relative to what three components do not explain.
_LEAST_CLEAR = 1.0
# Two thirds of the lights must be closer than this to those that the images show. Simulated
# correct recordings reach 5 degrees (a sphere in near light), shuffled ones 22 and more.
_SHUFFLED_DEG = 12.0
# A shuffled order leaves more than a tenth of the signal unexplained; any order that explains the
# images as well as they explain each other is not wrong.
_SHUFFLED_RESIDUAL = 0.1
_SHUFFLED_FACTOR = 1.5
# With fewer images than can be checked one by one, the residuals must differ by more.
_FEW_RESIDUAL = 0.15
_FEW_FACTOR = 2.5


@dataclass(frozen=True, eq=False)
class LightCheck:
    """What the images show about their lights.

    Parameters
    ----------
    consistency
        Median relative residual of the images as linear combinations of three; NaN without enough
        pixels.
    error_deg, gain
        ``(N,)`` angle between the given light and the one that the images show, and the brightness
        of the image relative to that light; NaN if the images do not determine it.
    factors
        Lights and normals that the images show; None if they do not follow the given lights.
    shuffled
        A warning if the lights are in another order.
    """

    consistency: float
    error_deg: Double
    gain: Double
    factors: Factors | None = None
    shuffled: Notice | None = None

    __repr__ = short_repr


def check_lights(samples: Samples, residual: float) -> LightCheck:
    """Compare the given lights of all images with those that the images show.

    Parameters
    ----------
    samples
        Samples of the N images.
    residual
        Median relative residual of the images under the given lights.
    """
    count = len(samples.vectors)
    unknown = np.full(count, np.nan)
    if count < _FEWEST_IMAGES or len(samples.values) < _FEWEST_PIXELS:
        return LightCheck(float("nan"), unknown, unknown)
    factors = factorise(samples.values, samples.usable)
    consistency = relative_residual(factors.deviation, samples.usable)
    weakest = factors.strengths[2]
    if weakest < max(_LEAST_RELIEF, _LEAST_CLEAR * consistency):
        return LightCheck(consistency, unknown, unknown)
    if count < _FEWEST_CHECKED:
        few = residual > max(_FEW_RESIDUAL, _FEW_FACTOR * consistency)
        warning = _shuffled(residual, consistency) if few else None
        return LightCheck(consistency, unknown, unknown, shuffled=warning)
    given = samples.vectors
    mapped = align(factors.lights, given)
    error = angles_deg(mapped, given)
    gain = np.linalg.norm(mapped, axis=1) / np.linalg.norm(given, axis=1)
    limit = max(_SHUFFLED_RESIDUAL, _SHUFFLED_FACTOR * consistency)
    if np.quantile(error, 2 / 3) > _SHUFFLED_DEG and residual > limit:
        return LightCheck(consistency, error, gain, shuffled=_shuffled(residual, consistency))
    if not explained(mapped, given):
        return LightCheck(consistency, unknown, unknown)
    return LightCheck(consistency, error, gain, factors)


def _shuffled(residual: float, consistency: float) -> Notice:
    text = (
        f"the images fit each other to {consistency:.1%}, but the lights only to {residual:.0%} of "
        "the signal: the lights are probably in another order than the images"
    )
    return Notice("lights-shuffled", text)
