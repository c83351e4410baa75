"""Calibration of a sensor by photon transfer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition import MeasuredSensor, Source
from acquisition.values import Measured
from calibration._errors import EstimateError
from calibration.sensor.dark_frames import DarkFrames, dark_frames
from calibration.sensor.photon_transfer import (
    Gain,
    Linearity,
    Points,
    Saturation,
    all_points,
    fit_gain,
    full_well,
    linearity,
    read_noise,
    root,
    saturation,
)
from calibration.sensor.recorded_series import SensorRecording, sensor_recording
from calibration.sensor.series_points import SeriesPoints, series_points
from rig import Notice, Progress, no_progress, short_repr
from rig.arrays import Bool, Float64

_STEADY = 1e-3
_NONLINEAR = 0.03


@dataclass(frozen=True, eq=False)
class SensorCalibration:
    """Figures of a sensor, and the curves behind them.

    Parameters
    ----------
    sensor
        The figures.
    signal_dn, variance_dn2
        ``(P,)`` photon-transfer curve: mean signal above dark and temporal variance of each zone at
        each exposure.
    dark_variance_dn2
        Temporal variance without light at an exposure time of 0.
    line_signal_dn, line_deviation
        ``(B,)`` signal, and its relative deviation from straight lines.
    dark_time_s, dark_mean_dn
        ``(D,)`` exposure time and mean of each dark frame.
    exposures
        Number of different exposure times.
    frames
        Number of frames that were read, with dark frames.
    warnings
        Doubts about the figures.
    """

    sensor: MeasuredSensor
    signal_dn: Float64
    variance_dn2: Float64
    dark_variance_dn2: float
    line_signal_dn: Float64
    line_deviation: Float64
    dark_time_s: Float64
    dark_mean_dn: Float64
    exposures: int
    frames: int
    warnings: tuple[Notice, ...] = ()

    __repr__ = short_repr


def calibrate_sensor(
    sources: Sequence[Source], on_progress: Progress = no_progress
) -> SensorCalibration:
    r"""Measure a sensor by photon transfer, after EMVA 1288, release 4.0 linear.

    The temporal variance of frames of the same exposure grows with their mean by the system gain.
    It is taken from differences between repeats, in zones of nearly equal light, so the field need
    not be even. The response of the pixels (PRNU) is what remains of the sum of exposures after
    division by a moving average over 11 x 11 pixels; texture of the card counts as PRNU, unless the
    lens is out of focus.

    Parameters
    ----------
    sources
        Recordings of an evenly lit field by one camera at one gain, without changes between the
        frames of one light: at least 5 exposure times, 2 or more frames of each, and dark frames.
        Raw samples, also of a colour mosaic. Dark frames of all recordings are used together.
    on_progress
        Called with the stage, the work done and the total.

    Returns
    -------
    SensorCalibration
        Figures with standard deviations. The dark current is None if all dark frames have the same
        exposure time; saturation, full well, signal-to-noise ratio and dynamic range are None if
        the exposures do not reach saturation.

    Raises
    ------
    DataError
        If the frames are not raw samples of one camera at one gain, or the dark frames are brighter
        than the others.
    EstimateError
        If there are too few exposures, repeats or dark frames, all exposures are saturated, the
        light varies by more than 10 %, or samples of dark frames are clipped at 0.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear (2021), sections 6 to 8.

    Examples
    --------
    >>> from acquisition import CapturePlan, Labels, read_source, record
    >>> from calibration import calibrate_sensor
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> plan = CapturePlan(leds=(0,), exposures_us=[500.0 * n for n in range(1, 81, 8)], repeats=2)
    >>> view = render(scene_named("white-plane", width=160, height=128, leds=1))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     _ = record(rig, plan, "card", Labels(operator="Ada", object_name="card"))
    >>> f"{calibrate_sensor([read_source('card')]).sensor.electrons_per_dn.value:.1f} e/DN"
    '2.5 e/DN'
    """
    recording = sensor_recording(sources)
    dark = dark_frames(recording.darks, on_progress)
    series = []
    for done, one in enumerate(recording.series, 1):
        series.append(series_points(one, dark, recording.cfa, 2**recording.bit_depth - 1))
        on_progress("exposures", done, len(recording.series))
    points = all_points(series)
    full = saturation(points)
    top = float(points.signal.max()) if full is None else full.signal
    gain = fit_gain(points, dark, top)
    below = [one.signal.max(axis=1) < top for one in series]
    flicker, warnings = _flicker(series, below)
    line = linearity(points, top, flicker)
    sensor = sensor_figures(recording, dark, series, points, gain, full, line)
    where = str(sources[0].path)
    if full is None:
        text = (
            "no exposure reaches saturation: full well, signal-to-noise ratio and dynamic range "
            "are unknown; record longer exposure times"
        )
        warnings.append(Notice("saturation-not-reached", text, where, "info"))
    if sensor.dark_current_e_per_s is None:
        text = (
            "all dark frames have the same exposure time: the dark current is unknown; record "
            "several exposure times"
        )
        warnings.append(Notice("dark-current-unknown", text, where, "info"))
    if sensor.linearity_error.value > _NONLINEAR:
        text = (
            f"the signal deviates by {sensor.linearity_error.value:.1%} from a straight line: is a "
            "gamma or a lookup table on in the camera, or an automatic?"
        )
        warnings.append(Notice("sensor-not-linear", text, where))
    frames = len(recording.darks) + sum(
        len(group.frames) for one in recording.series for group in one.exposures
    )
    return SensorCalibration(
        sensor,
        points.signal,
        points.variance,
        gain.dark_variance,
        line.signal,
        line.deviation,
        dark.time_s,
        dark.mean_dn,
        len(np.unique(points.time_s)),
        frames,
        (*(notice for source in sources for notice in source.warnings), *warnings),
    )


def _flicker(series: Sequence[SeriesPoints], below: Sequence[Bool]) -> tuple[float, list[Notice]]:
    """Return the flicker of the mean of an exposure, and a notice if it exceeds the noise."""
    seen = np.concatenate([one.flicker[use] for one, use in zip(series, below, strict=True)])
    noise = np.concatenate([one.flicker_noise[use] for one, use in zip(series, below, strict=True)])
    if not len(seen):
        return 0.0, []
    excess = max(float(np.mean(seen**2 - noise**2)), 0.0) ** 0.5
    if excess < _STEADY:
        return excess, []
    text = (
        f"the light varies by {excess:.2%} between frames of one exposure; the noise was corrected "
        "for it, but the linearity error contains it"
    )
    return excess, [Notice("lamp-flickers", text)]


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
    return gain.in_electrons(root(squared, (2 / int(dark.good.sum())) ** 0.5 * total))


def _prnu(series: Sequence[SeriesPoints]) -> Measured:
    weight = np.array([one.prnu_weight for one in series])
    if not weight.any():
        raise EstimateError(
            "no exposure is between 20 % and 75 % of the brightest one, which the response of the "
            "pixels needs: record more brackets"
        )
    squared = float(weight @ [one.prnu_squared for one in series]) / float(weight.sum())
    return root(squared, float(weight.sum()) ** -0.5)


def _hot_pixels(dark: DarkFrames, e_per_dn: float) -> dict[str, float]:
    """Return share and mean dark current of the pixels with far more dark current."""
    hot = ~dark.good & (dark.slope > dark.current_dn_per_s)
    if not dark.sloped or not hot.any():
        return {}
    excess = float(dark.slope[hot].mean(dtype=np.float64)) - dark.current_dn_per_s
    return {"hot_pixel_fraction": float(hot.mean()), "hot_pixel_e_per_s": excess * e_per_dn}
