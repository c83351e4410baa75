"""Sensor model: how light becomes grey values, and the noise of the grey values."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from rig.arrays import Float64


@dataclass(frozen=True)
class NoiseModel:
    """A linear sensor, described by the parameters of EMVA 1288.

    Parameters
    ----------
    electrons_per_dn
        Electrons per grey value (the inverse of the system gain K).
    read_noise_e
        Temporal noise in the dark, electrons rms.
    black_level_dn
        Mean grey value without light.
    bit_depth
        Bits of the converter, whose largest value is ``2 ** bit_depth - 1``.
    quantum_efficiency
        Electrons per photon, above 0 and at most 1. With 1, photons are counted in electrons.
    full_well_e
        Electrons at which a pixel is full; None if the converter always saturates first.
    dark_current_e_per_s
        Electrons per second without light; they have shot noise too.
    dsnu_e
        Standard deviation of the pixels' offsets in the dark, electrons.
    prnu
        Relative standard deviation of the pixels' response to light, less than 0.3.
    hot_pixel_fraction
        Share of hot pixels, whose dark current is far higher, 0 to 1.
    hot_pixel_e_per_s
        Mean additional dark current of hot pixels, electrons per second.

    Raises
    ------
    DataError
        If a value is outside its range.
    """

    electrons_per_dn: float
    read_noise_e: float
    black_level_dn: float
    bit_depth: int
    quantum_efficiency: float = 1.0
    full_well_e: float | None = None
    dark_current_e_per_s: float = 0.0
    dsnu_e: float = 0.0
    prnu: float = 0.0
    hot_pixel_fraction: float = 0.0
    hot_pixel_e_per_s: float = 0.0

    def __repr__(self) -> str:
        return (
            f"NoiseModel({self.electrons_per_dn:g} e/DN, read noise {self.read_noise_e:g} e, "
            f"black level {self.black_level_dn:g} DN, {self.bit_depth} bit)"
        )

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if value is not None and not math.isfinite(value):
                raise DataError(f"a sensor needs finite numbers, but {item.name} is {value}")
        if not self.electrons_per_dn > 0 or not self.read_noise_e >= 0:
            raise DataError("a sensor needs electrons_per_dn > 0 and read_noise_e >= 0")
        if not 0 < self.quantum_efficiency <= 1:
            raise DataError("a sensor needs a quantum_efficiency above 0 and at most 1")
        for name in ("dark_current_e_per_s", "dsnu_e", "hot_pixel_e_per_s"):
            if getattr(self, name) < 0:
                raise DataError(f"a sensor needs {name} >= 0, not {getattr(self, name)}")
        if not 0 <= self.prnu < 0.3 or not 0 <= self.hot_pixel_fraction <= 1:
            raise DataError("a sensor needs prnu within 0..0.3 and hot_pixel_fraction within 0..1")
        if not 8 <= self.bit_depth <= 16 or not 0 <= self.black_level_dn < self.white_level_dn:
            raise DataError(
                "a sensor needs 8 to 16 bits and a black level below its white level, at which "
                "the converter saturates or the pixel is full"
            )

    @property
    def converter_end_dn(self) -> int:
        """Largest grey value of the converter."""
        return int(2**self.bit_depth - 1)

    @property
    def white_level_dn(self) -> int:
        """Grey value from which a sample counts as saturated.

        This is the largest value of the converter or, if lower, the value of a full pixel without
        analogue gain, minus four standard deviations of its noise, so that every full pixel counts.
        """
        if self.full_well_e is None:
            return self.converter_end_dn
        noise_e = math.hypot(self.read_noise_e, self.dsnu_e)
        full = (self.full_well_e - 4 * noise_e) / self.electrons_per_dn
        # Absurd numbers give an infinite difference, which has no integer value.
        return math.floor(min(self.converter_end_dn, max(self.black_level_dn + full, 0.0)))

    def at_gain(self, gain_db: float) -> NoiseModel:
        """Return the sensor with additional analogue gain, decibels (20 dB = tenfold).

        The read noise in electrons is kept, although that of most sensors falls somewhat.
        """
        if not gain_db:
            return self
        return replace(self, electrons_per_dn=self.electrons_per_dn / 10.0 ** (gain_db / 20.0))

    def variance_dn(self, grey_dn: npt.ArrayLike) -> Float64:
        """Return the temporal variance (grey values squared) at mean grey values.

        The variance contains shot noise, read noise and the quantisation of one grey value, EMVA
        1288 equation 10. Dark current is part of the grey value and so of its shot noise.
        Fixed-pattern noise is not temporal and not included.
        """
        electrons = np.clip(np.asarray(grey_dn, np.float64) - self.black_level_dn, 0.0, None)
        electrons *= self.electrons_per_dn
        noise: Float64 = (electrons + self.read_noise_e**2) / self.electrons_per_dn**2
        return noise + 1.0 / 12.0
