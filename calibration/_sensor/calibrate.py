"""Calibration of a sensor by photon transfer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import MeasuredSensor, Source
from calibration._sensor.dark_frames import dark_frames
from calibration._sensor.figures import sensor_figures
from calibration._sensor.photon_transfer import all_points, fit_gain, linearity, saturation
from calibration._sensor.recorded_series import sensor_recording
from calibration._sensor.series_points import SeriesPoints, series_points
from rig import Notice, Progress, no_progress, short_repr

Array = npt.NDArray[np.float64]

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
    signal_dn: Array
    variance_dn2: Array
    dark_variance_dn2: float
    line_signal_dn: Array
    line_deviation: Array
    dark_time_s: Array
    dark_mean_dn: Array
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


def _flicker(
    series: Sequence[SeriesPoints], below: Sequence[npt.NDArray[np.bool_]]
) -> tuple[float, list[Notice]]:
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
