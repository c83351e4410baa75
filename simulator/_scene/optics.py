"""The thin lens: circle of confusion and diffraction, in pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from rig import short_repr

Array = npt.NDArray[np.float64]

# Standard deviation of the Gaussian closest to an Airy pattern, in wavelengths times f-number
# (Zhang, Zerubia and Olivo-Marin, Gaussian approximations of fluorescence microscope point-spread
# function models, 2007).
_AIRY = 0.42


@dataclass(frozen=True)
class Optics:
    """Aperture and focus of a perspective lens.

    Parameters
    ----------
    f_number
        Focal length over diameter of the aperture.
    focal_length_mm
        Focal length; with the camera's matrix, it determines the size of a pixel.
    focus_mm
        Distance of the plane of focus from the centre of projection, larger than the focal length;
        None for the camera's working distance.
    wavelength_um
        Wavelength of the light.

    Raises
    ------
    DataError
        If a value is not positive.
    """

    f_number: float = 8.0
    focal_length_mm: float = 16.0
    focus_mm: float | None = None
    wavelength_um: float = 0.55

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in ("f_number", "focal_length_mm", "focus_mm", "wavelength_um"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise DataError(f"lens: {name} is {value}, it must be positive")

    def circle_px(self, depth_mm: Array, focus_mm: float, focal_px: float) -> Array:
        """Return the diameters of the circles of confusion of points at depths.

        A point at depth s has the diameter ``focal_length / f_number * focal_px |1/s - 1/focus|``:
        the aperture as seen from the point, on the plane of focus, in pixels of that plane.
        """
        aperture_mm = self.focal_length_mm / self.f_number
        return aperture_mm * focal_px * np.abs(1 / depth_mm - 1 / focus_mm)

    def diffraction_px(self, focal_px: float) -> float:
        """Return the standard deviation of the Gaussian that replaces the Airy pattern.

        The pattern has ``0.42 wavelength v / D`` for the image distance v and the aperture D;
        v in pixels is ``focal_px``.
        """
        return _AIRY * 1e-3 * self.wavelength_um * focal_px * self.f_number / self.focal_length_mm
