"""Parameters of profiles (ISO 21920-2)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from acquisition import DataError
from processing.roughness.areal_parameters import Parameter
from processing.roughness.form import ORDERS
from processing.roughness.gaussian import mean_line
from processing.roughness.scale_limited import Resolution, Scales
from rig import figure, short_repr
from rig.arrays import Float64

PROFILE: Final[Mapping[str, Parameter]] = {
    "Ra": Parameter("height", "um", "arithmetic mean height", True),
    "Rq": Parameter("height", "um", "root mean square height", True),
    "Rp": Parameter("height", "um", "mean peak height of the sections", True),
    "Rv": Parameter("height", "um", "mean pit depth of the sections", True),
    "Rz": Parameter("height", "um", "mean maximum height of the sections", True),
    "Rt": Parameter("height", "um", "total height", True),
    "Rsk": Parameter("ratio", "", "skewness", False),
    "Rku": Parameter("ratio", "", "kurtosis", False),
    "RSm": Parameter("length", "mm", "mean width of the profile elements", False),
    "Rdq": Parameter("slope", "", "root mean square gradient", True),
    "Wa": Parameter("height", "um", "arithmetic mean height of the waviness", True),
    "Wq": Parameter("height", "um", "root mean square height of the waviness", True),
    "Wt": Parameter("height", "um", "total height of the waviness", True),
}
# A profile element rises above and falls below the mean line by this share of Rz.
_LEAST_RISE = 0.1


@dataclass(frozen=True, eq=False)
class Profile:
    """Roughness and waviness of a profile.

    Parameters
    ----------
    roughness_mm, waviness_mm
        ``(N,)`` heights at the pixels of the line.
    step_mm
        Distance between them.
    sections
        Number of section lengths in the profile.
    """

    roughness_mm: Float64
    waviness_mm: Float64
    step_mm: float
    sections: int

    __repr__ = short_repr


def scale_limited_profile(heights_mm: Float64, scales: Scales, resolution: Resolution) -> Profile:
    """Return roughness and waviness of a profile (ISO 16610-21, ISO 21920-2).

    Parameters
    ----------
    heights_mm
        ``(N,)`` heights, one per pixel.
    scales
        Form, of which a profile has polynomials only, and both nesting indices, which are called
        cut-off wavelengths here.
    resolution
        What the instrument transmits.

    Raises
    ------
    DataError
        If heights are missing, the form is a sphere or cylinder, or the profile
        is shorter than a section.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import Resolution, Scales, scale_limited_profile
    >>> line = np.sin(np.arange(400) / 4) + 0.1 * np.arange(400)
    >>> profile = scale_limited_profile(line, Scales("plane", 0.05, 0.8), Resolution(0.01))
    >>> profile.sections
    5
    """
    if not np.isfinite(heights_mm).all():
        raise DataError(
            "the line crosses a hole or a jump, or leaves the surface: heights on both sides are "
            "not connected; use a line on one side"
        )
    pixel, s_mm, l_mm = resolution.pixel_mm, scales.s_mm or 0.0, scales.l_mm or 0.0
    if scales.form not in ORDERS and scales.form != "none":
        raise DataError(f"a profile has no {scales.form}: use a polynomial such as quadric")
    heights = mean_line(heights_mm - heights_mm.mean(), s_mm / pixel, removed_px=resolution.blur_px)
    if scales.form != "none":
        at = np.linspace(-1, 1, len(heights))
        fitted = np.polynomial.legendre.legfit(at, heights, ORDERS[scales.form])
        heights = heights - np.polynomial.legendre.legval(at, fitted)
    waves = mean_line(heights, l_mm / pixel, robust=scales.robust) if l_mm else 0 * heights
    sections = int(len(heights) * pixel / l_mm + 1e-9) if l_mm else 1
    if sections < 1:
        raise DataError(
            f"the line is {figure(len(heights) * pixel, 3)} mm long, shorter than a section "
            f"of {l_mm:g} mm"
        )
    return Profile(heights - waves, waves, pixel, sections)


def profile_parameters(profile: Profile) -> dict[str, float]:
    """Return the parameters of a profile by the names of `PROFILE`, NaN where not defined.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import Resolution, Scales
    >>> from processing.roughness import profile_parameters, scale_limited_profile
    >>> wave = 0.001 * np.sin(2 * np.pi * np.arange(1000) / 50)
    >>> profile = scale_limited_profile(wave, Scales("level", 0.05, 0), Resolution(0.01))
    >>> round(profile_parameters(profile)["RSm"], 3)
    0.5
    """
    found = dict.fromkeys(PROFILE, math.nan)
    values = 1000 * (profile.roughness_mm - profile.roughness_mm.mean())
    root = float(np.sqrt(np.mean(values**2)))
    found |= {"Ra": float(np.abs(values).mean()), "Rq": root, "Rt": float(np.ptp(values))}
    parts = np.array_split(values, profile.sections)
    found["Rp"] = float(np.mean([part.max() for part in parts]))
    found["Rv"] = float(-np.mean([part.min() for part in parts]))
    found["Rz"] = found["Rp"] + found["Rv"]
    if root > 0:
        found["Rsk"] = float(np.mean(values**3)) / root**3
        found["Rku"] = float(np.mean(values**4)) / root**4
    found["RSm"] = profile.step_mm * _mean_width(values, _LEAST_RISE * found["Rz"])
    slopes = np.gradient(values / 1000, profile.step_mm)
    found["Rdq"] = float(np.sqrt(np.mean(slopes**2)))
    waves = 1000 * (profile.waviness_mm - profile.waviness_mm.mean())
    if profile.waviness_mm.any():
        found["Wa"] = float(np.abs(waves).mean())
        found["Wq"] = float(np.sqrt(np.mean(waves**2)))
        found["Wt"] = float(np.ptp(waves))
    return found


def _mean_width(values: Float64, least: float) -> float:
    """Return the mean distance, in samples, of upward crossings of the mean line.

    A crossing counts if the profile falls below ``-least`` before it and rises above ``least``
    after it (ISO 21920-2, crossing-the-line segmentation).
    """
    crossings = []
    state, last = 0, math.nan
    for i, value in enumerate(values):
        if i and values[i - 1] < 0 <= value:
            last = i - 1 + values[i - 1] / (values[i - 1] - value)
        if value > least:
            if state < 0:
                crossings.append(last)
            state = 1
        elif value < -least:
            state = -1
    if len(crossings) < 2:
        return math.nan
    return float(crossings[-1] - crossings[0]) / (len(crossings) - 1)
