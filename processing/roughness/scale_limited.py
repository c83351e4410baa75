"""The part of a surface between two scales: form removed, finest and longest waves filtered."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from acquisition import DataError
from processing.maps.mask import bounding_box
from processing.roughness.form import Form, fit_form
from processing.roughness.gaussian import mean_surface
from rig import figure
from rig.arrays import Bool, Floating

# Nesting indices in mm (ISO 25178-3, table 1): 1, 2, 2.5, 5 and 8 of each decade.
NESTING_MM: Final = tuple(
    float(f"{digit}e{power}") for power in range(-4, 3) for digit in (1, 2, 2.5, 5, 8)
)
# Pixels of the shortest wave that counts: 5 samples per S-filter nesting index (ISO 25178-3).
_LEAST_PIXELS = 5
# Nesting indices of the L-filter along the shorter side of an area, as the five sampling lengths of
# a profile.
_SECTIONS = 5
# Blur of a usual lens in focus with the aperture of a pixel, in pixels, and relative standard
# deviations of it and of a blur that normals show.
_USUAL_PX, _USUAL_SPREAD, _SHOWN_SPREAD = 0.76, 0.25, 0.15
# A Gaussian of standard deviation 1 transmits half of a wave of this length.
_HALF: Final = math.pi * math.sqrt(2 / math.log(2))


@dataclass(frozen=True)
class Resolution:
    """What the instrument transmits.

    Parameters
    ----------
    pixel_mm
        Distance between neighbouring pixels.
    blur_px
        Standard deviation of the blur by the lens and the aperture of a pixel, in pixels.
    blur_sigma_px
        Standard deviation of `blur_px`.
    shown
        Whether the blur of this lens is known, not only that of usual ones.
    """

    pixel_mm: float
    blur_px: float = 0.0
    blur_sigma_px: float = 0.0
    shown: bool = True

    @classmethod
    def seen(cls, pixel_mm: float, blur_px: float | None) -> Resolution:
        """Return that of a recording whose normals show a blur, or None: a usual lens in focus."""
        if blur_px is None:
            return cls(pixel_mm, _USUAL_PX, _USUAL_SPREAD * _USUAL_PX, shown=False)
        return cls(pixel_mm, blur_px, _SHOWN_SPREAD * blur_px)

    @property
    def lateral_mm(self) -> float:
        """Length of the wave of which half of the amplitude remains (ISO 25178-600)."""
        return max(_HALF * self.blur_px, 2.0) * self.pixel_mm

    @property
    def least_mm(self) -> float:
        """Smallest nesting index of an S-filter that these pixels can fulfil."""
        return max(self.lateral_mm, _LEAST_PIXELS * self.pixel_mm)


@dataclass(frozen=True)
class Scales:
    """Operators that make a scale-limited surface of heights (ISO 25178-2).

    Parameters
    ----------
    form
        Form that is removed (F-operation).
    s_mm
        Nesting index of the S-filter, which removes shorter waves; None for the smallest one of
        ISO 25178-3 that the instrument resolves.
    l_mm
        Nesting index of the L-filter, which removes longer waves; 0 for none; None for the largest
        one of ISO 25178-3 that fits five times into the shorter side of the area.
    robust
        Whether form and L-filter give outliers little weight.
    """

    form: Form = "plane"
    s_mm: float | None = None
    l_mm: float | None = None
    robust: bool = False

    def resolved(self, resolution: Resolution, side_mm: float) -> Scales:
        """Return the same with both nesting indices.

        Parameters
        ----------
        resolution
            What the instrument transmits.
        side_mm
            Shorter side of the area.

        Raises
        ------
        DataError
            If a nesting index is below the resolution, or does not fit the area.
        """
        least = resolution.least_mm
        s_mm = self.s_mm
        if s_mm is None:
            s_mm = next((one for one in NESTING_MM if one >= least), least)
        elif s_mm < least:
            raise DataError(
                f"an S-filter of {s_mm:g} mm is below what the images resolve: use {figure(least)} "
                f"mm or more (lateral resolution {figure(resolution.lateral_mm)} mm, pixels of "
                f"{figure(resolution.pixel_mm)} mm)"
            )
        l_mm = self.l_mm
        if l_mm is None:
            fitting = [one for one in NESTING_MM if s_mm < one <= side_mm / _SECTIONS]
            l_mm = fitting[-1] if fitting else 0.0
        if 0 < l_mm <= s_mm:
            raise DataError(
                f"an L-filter of {l_mm:g} mm leaves nothing of an S-filter of {s_mm:g} mm: use more"
            )
        if side_mm < max(l_mm, s_mm):
            raise DataError(
                f"the area is {figure(side_mm, 3)} mm wide, too small for a filter of "
                f"{max(l_mm, s_mm):g} mm: the smallest area is {max(l_mm, s_mm):g} mm wide"
            )
        return Scales(self.form, s_mm, l_mm, self.robust)


def scale_limited(
    heights_mm: Floating,
    area: Bool,
    scales: Scales,
    resolution: Resolution,
    *,
    other_fit: bool = False,
) -> Floating:
    """Return the scale-limited heights of an area.

    The blur of lens and pixels is a part of the S-filter: only what it lacks is filtered, so
    instruments of different sharpness show the same surface. The integration of normals is not a
    blur: it transmits ``1 - 23 f^4`` of a frequency f per pixel.

    Parameters
    ----------
    heights_mm
        ``(H, W)``, NaN where they are not known.
    area
        ``(H, W)`` bool. Form and filters also read what is known up to one nesting index beyond it,
        so that it has no border effects: let heights that do not belong to the surface be NaN.
    scales
        The operators, with both nesting indices.
    resolution
        What the instrument transmits.
    other_fit
        Fit the form robustly if it is not to be, and the other way round.

    Returns
    -------
    ``(H, W)`` mm, NaN outside the area.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import Resolution, Scales, scale_limited
    >>> y, x = np.mgrid[:60, :80] * 0.01
    >>> wave = 0.001 * np.sin(2 * np.pi * x / 0.1)
    >>> area = np.ones(wave.shape, bool)
    >>> found = scale_limited(wave + 0.2 * x, area, Scales("plane", 0.05, 0), Resolution(0.01))
    >>> round(float(np.std(found) / np.std(wave)), 1)
    0.8
    """
    if scales.s_mm is None or scales.l_mm is None:
        raise DataError("nesting indices are missing: use those of `Scales.resolved`")
    pixel = resolution.pixel_mm
    margin = math.ceil(max(scales.s_mm, scales.l_mm) / pixel)
    rows, columns = (
        slice(max(part.start - margin, 0), part.stop + margin) for part in bounding_box(area)
    )
    part, inside = heights_mm[rows, columns], area[rows, columns]
    # Filters lose digits of large heights.
    limited: Floating = part - part.dtype.type(_mean(part, inside & np.isfinite(part)))
    limited = mean_surface(limited, scales.s_mm / pixel, removed_px=resolution.blur_px)
    limited -= fit_form(limited, pixel, scales.form, robust=scales.robust != other_fit).heights
    if scales.l_mm > 0:
        limited -= mean_surface(limited, scales.l_mm / pixel, robust=scales.robust)
    limited -= limited.dtype.type(_mean(limited, inside & np.isfinite(limited)))
    limited[~inside] = np.nan
    found = np.full(heights_mm.shape, np.nan, heights_mm.dtype)
    found[rows, columns] = limited
    return found


def _mean(heights: Floating, where: Bool) -> float:
    return float(np.mean(heights, dtype=np.float64, where=where))
