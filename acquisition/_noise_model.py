"""The sensor as numbers: how radiance becomes grey values, and how uncertain they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError


@dataclass(frozen=True)
class NoiseModel:
    """A linear sensor in the terms of EMVA 1288.

    Parameters
    ----------
    electrons_per_dn
        Electrons for one grey value (the inverse of the system gain K).
    read_noise_e
        Temporal noise in the dark, electrons rms.
    black_level_dn
        Mean grey value without light.
    bit_depth
        Bits of the converter; the white level is ``2 ** bit_depth - 1``.

    Raises
    ------
    DataError
        If a value is outside its range.
    """

    electrons_per_dn: float
    read_noise_e: float
    black_level_dn: float
    bit_depth: int

    def __post_init__(self) -> None:
        if not self.electrons_per_dn > 0 or not self.read_noise_e >= 0:
            raise DataError("a sensor needs electrons_per_dn > 0 and read_noise_e >= 0")
        if not 8 <= self.bit_depth <= 16 or not 0 <= self.black_level_dn < self.white_level_dn:
            raise DataError("a sensor has 8 to 16 bits and a black level below its white level")

    @property
    def white_level_dn(self) -> int:
        """The grey value at which a sample counts as saturated."""
        return int(2**self.bit_depth - 1)

    def variance_dn(self, grey_dn: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the temporal variance (grey values squared) at mean grey values.

        Shot and read noise plus the quantisation of one grey value, EMVA 1288 equation 10.
        """
        electrons = np.clip(np.asarray(grey_dn, np.float64) - self.black_level_dn, 0.0, None)
        electrons *= self.electrons_per_dn
        noise: npt.NDArray[np.float64] = (
            electrons + self.read_noise_e**2
        ) / self.electrons_per_dn**2
        return noise + 1.0 / 12.0
