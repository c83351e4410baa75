"""A measured sensor: figures of EMVA 1288 with standard deviations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import Literal

from acquisition._errors import DataError
from acquisition.values.noise_model import NoiseModel
from acquisition.values.setup import Setup
from rig import short_repr


@dataclass(frozen=True)
class Measured:
    """A measured figure.

    Parameters
    ----------
    value
        The estimate.
    sigma
        Its standard deviation, in the unit of the value, not negative.

    Raises
    ------
    DataError
        If a number is not finite or the standard deviation is negative.
    """

    value: float
    sigma: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.value) or not math.isfinite(self.sigma) or self.sigma < 0:
            raise DataError(
                "a measured figure needs a finite value and a finite standard deviation of at "
                f"least 0, not {self.value} and {self.sigma}"
            )


@dataclass(frozen=True)
class MeasuredSensor:
    """Figures of a sensor, measured by photon transfer.

    Parameters
    ----------
    bit_depth
        Bits of the converter.
    gain_db
        Analogue gain of the measurement, decibels.
    electrons_per_dn
        Electrons per grey value, the inverse of the system gain K.
    read_noise_e
        Temporal noise in the dark at an exposure time of 0, electrons, without quantisation.
    black_level_dn
        Mean grey value without light at an exposure time of 0.
    dsnu_e
        Standard deviation of the pixels in the dark, electrons.
    prnu
        Relative standard deviation of the pixels' response to light.
    linearity_error
        Mean relative deviation of the signal from a straight line, 0.01 for 1 %.
    dark_current_e_per_s
        Electrons per second without light; None if it was not measured.
    full_well_e
        Electrons at which samples saturate; None if no exposure saturated.
    full_well_limit
        What saturates: the ``converter`` or the ``pixel``; None if it is not known.
    saturation_capacity_e
        Electrons where the temporal variance is largest, the saturation capacity of EMVA 1288.
    snr_max
        Signal-to-noise ratio of a single sample at the saturation capacity.
    dynamic_range
        Saturation capacity divided by the signal whose signal-to-noise ratio is 1.
    hot_pixel_fraction
        Share of pixels whose dark current is far above that of the others.
    hot_pixel_e_per_s
        Mean additional dark current of these pixels, electrons per second.
    setup
        The camera.
    time_utc
        Start of the recording; None if it is not known.

    Raises
    ------
    DataError
        If a figure is outside its range.
    """

    bit_depth: int
    gain_db: float
    electrons_per_dn: Measured
    read_noise_e: Measured
    black_level_dn: Measured
    dsnu_e: Measured
    prnu: Measured
    linearity_error: Measured
    dark_current_e_per_s: Measured | None = None
    full_well_e: Measured | None = None
    full_well_limit: Literal["converter", "pixel"] | None = None
    saturation_capacity_e: Measured | None = None
    snr_max: Measured | None = None
    dynamic_range: Measured | None = None
    hot_pixel_fraction: float = 0.0
    hot_pixel_e_per_s: float = 0.0
    setup: Setup = field(default_factory=Setup)
    time_utc: datetime | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if (self.full_well_e is None) != (self.full_well_limit is None):
            raise DataError("a measured sensor needs full_well_e and full_well_limit, or neither")
        self.noise_model(self.gain_db)

    @property
    def figures(self) -> dict[str, Measured]:
        """The measured figures by name."""
        values = ((item.name, getattr(self, item.name)) for item in fields(self))
        return {name: value for name, value in values if isinstance(value, Measured)}

    def noise_model(self, gain_db: float = 0.0) -> NoiseModel:
        """Return the sensor as a noise model.

        Parameters
        ----------
        gain_db
            Analogue gain of the model, decibels. The read noise in electrons is that of the
            measurement.

        Raises
        ------
        DataError
            If the figures are not those of a sensor.
        """
        full_well = self.full_well_e if self.full_well_limit == "pixel" else None
        current = self.dark_current_e_per_s
        return NoiseModel(
            electrons_per_dn=self.electrons_per_dn.value,
            read_noise_e=self.read_noise_e.value,
            black_level_dn=max(self.black_level_dn.value, 0.0),
            bit_depth=self.bit_depth,
            full_well_e=None if full_well is None else full_well.value,
            dark_current_e_per_s=0.0 if current is None else max(current.value, 0.0),
            dsnu_e=self.dsnu_e.value,
            prnu=self.prnu.value,
            hot_pixel_fraction=self.hot_pixel_fraction,
            hot_pixel_e_per_s=self.hot_pixel_e_per_s,
        ).at_gain(gain_db - self.gain_db)
