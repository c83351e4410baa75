"""Figures of a sensor in electrons, with standard deviations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from acquisition import Measured, MeasuredSensor
from calibration._errors import EstimateError
from calibration._sensor.dark_frames import DarkFrames
from calibration._sensor.photon_transfer import (
    Gain,
    Linearity,
    Points,
    Saturation,
    full_well,
    read_noise,
)
from calibration._sensor.recorded_series import SensorRecording
from calibration._sensor.series_points import SeriesPoints


def sensor_figures(
    recording: SensorRecording,
    dark: DarkFrames,
    series: Sequence[SeriesPoints],
    points: Points,
    gain: Gain,
    full: Saturation | None,
    line: Linearity,
) -> MeasuredSensor:
    """Return the figures in electrons.

    Raises
    ------
    EstimateError
        If no exposure shows the response of the pixels.
    """
    e_per_dn = 1 / gain.dn_per_e
    relative = gain.sigma * e_per_dn
    noise = read_noise(gain)
    capacity = snr_max = dynamic_range = well = None
    if full is not None:
        value = full.signal * e_per_dn
        share = float(np.hypot(relative, full.sigma / full.signal))
        capacity = Measured(value, share * value)
        snr_max = Measured(value**0.5, value**0.5 * share / 2)
        # The signal whose signal-to-noise ratio is 1, in the approximation of the standard.
        least = gain.dark_variance**0.5 * e_per_dn + 0.5
        of_least = noise.sigma / least
        dynamic_range = Measured(value / least, value / least * float(np.hypot(share, of_least)))
        well = full_well(points, dark, full.signal)
    electrons = None
    if well is not None:
        sigma = float(np.hypot(relative * well.signal, well.sigma))
        electrons = Measured(well.signal * e_per_dn, sigma * e_per_dn)
    return MeasuredSensor(
        bit_depth=recording.bit_depth,
        gain_db=recording.gain_db,
        electrons_per_dn=Measured(e_per_dn, relative * e_per_dn),
        read_noise_e=noise,
        black_level_dn=Measured(dark.black_dn, _drift(dark, gain) * dark.leverage(0.0) ** 0.5),
        dsnu_e=_dsnu(dark, gain),
        prnu=_prnu(series),
        linearity_error=line.error,
        dark_current_e_per_s=_dark_current(dark, gain),
        full_well_e=electrons,
        full_well_limit=None if well is None else well.limit,
        saturation_capacity_e=capacity,
        snr_max=snr_max,
        dynamic_range=dynamic_range,
        **_hot_pixels(dark, e_per_dn),
        setup=recording.setup,
        time_utc=recording.time_utc,
    )


def _drift(dark: DarkFrames, gain: Gain) -> float:
    """Return the standard deviation of the mean of a dark frame: noise, or drift if it is more."""
    noise = gain.dark_variance / int(dark.good.sum())
    line = np.polyfit(dark.time_s, dark.mean_dn, int(dark.sloped))
    residual = dark.mean_dn - np.polyval(line, dark.time_s)
    return math.sqrt(max(noise, float(np.sum(residual**2)) / dark.free))


def _dark_current(dark: DarkFrames, gain: Gain) -> Measured | None:
    if not dark.sloped:
        return None
    value = dark.current_dn_per_s / gain.dn_per_e
    sigma = _drift(dark, gain) / dark.spread_s2**0.5
    return Measured(value, float(np.hypot(sigma, value * gain.sigma)) / gain.dn_per_e)


def _dsnu(dark: DarkFrames, gain: Gain) -> Measured:
    """Return the spatial deviation of the mean dark frame, less that of its temporal noise."""
    total = dark.level_variance
    squared = total - dark.residual / dark.free / len(dark.time_s)
    in_dn = _root(squared, (2 / int(dark.good.sum())) ** 0.5 * total)
    sigma = float(np.hypot(in_dn.sigma, in_dn.value * gain.sigma / gain.dn_per_e))
    return Measured(in_dn.value / gain.dn_per_e, sigma / gain.dn_per_e)


def _prnu(series: Sequence[SeriesPoints]) -> Measured:
    weight = np.array([one.prnu_weight for one in series])
    if not weight.any():
        raise EstimateError(
            "no exposure is between 20 % and 75 % of the brightest one, which the response of the "
            "pixels needs: record more brackets"
        )
    squared = float(weight @ [one.prnu_squared for one in series]) / float(weight.sum())
    return _root(squared, float(weight.sum()) ** -0.5)


def _root(squared: float, sigma: float) -> Measured:
    """Return the root of a variance; near 0, its deviation is limited by that of the variance."""
    return Measured(max(squared, 0.0) ** 0.5, sigma / (2 * max(squared, sigma) ** 0.5))


def _hot_pixels(dark: DarkFrames, e_per_dn: float) -> dict[str, float]:
    """Return share and mean dark current of the pixels with far more dark current."""
    hot = ~dark.good & (dark.slope > dark.current_dn_per_s)
    if not dark.sloped or not hot.any():
        return {}
    excess = float(dark.slope[hot].mean(dtype=np.float64)) - dark.current_dn_per_s
    return {
        "hot_pixel_fraction": float(hot.mean()),
        "hot_pixel_e_per_s": excess * e_per_dn,
    }
