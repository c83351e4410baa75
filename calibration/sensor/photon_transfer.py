"""Figures of a sensor from its photon-transfer curve (EMVA 1288, release 4.0 linear)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from acquisition.values import Measured
from calibration._errors import EstimateError
from calibration.sensor.dark_frames import DarkFrames
from calibration.sensor.series_points import SeriesPoints
from rig.arrays import Float64, Intp

# EMVA 1288: the gain is fitted up to 70 % of saturation, the straight line from 5 % to 95 %.
_GAIN_TO = 0.7
_LINE_FROM, _LINE_TO = 0.05, 0.95
_FEWEST_EXPOSURES = 5
_QUANTISATION = 1 / 12
# The curve is averaged in steps of this share of its largest signal.
_STEP = 0.005
# Beyond saturation, the variance is below this share of its maximum.
_FALLEN = 0.75
# A zone is certainly full where a straight line would be this far above the largest signal.
_FULL = 1.15
_LINE_STEP = 0.05


@dataclass(frozen=True, eq=False)
class Points:
    """Signal and variance of every zone at every exposure; P of them.

    Parameters
    ----------
    time_s, signal, variance, white, freedom
        As in `SeriesPoints`, each ``(P,)``.
    zone
        ``(P,)`` number of the zone; zones of different series differ.
    """

    time_s: Float64
    signal: Float64
    variance: Float64
    white: Float64
    freedom: Float64
    zone: Intp


def all_points(series: Sequence[SeriesPoints]) -> Points:
    """Return the points of all series."""
    first = np.cumsum([0, *(one.signal.shape[1] for one in series)])
    times = [np.repeat(one.time_s, one.signal.shape[1]) for one in series]
    zones = [
        np.tile(start + np.arange(one.signal.shape[1]), len(one.time_s))
        for start, one in zip(first, series, strict=False)
    ]
    signal, variance, white, freedom = (
        np.concatenate([getattr(one, name).ravel() for one in series])
        for name in ("signal", "variance", "white", "freedom")
    )
    zone = np.concatenate(zones)
    return Points(np.concatenate(times), signal, variance, white, freedom, zone)


@dataclass(frozen=True)
class Saturation:
    """Where the temporal variance is largest; ``sigma`` is the distance of neighbouring levels."""

    signal: float
    sigma: float


def saturation(points: Points) -> Saturation | None:
    """Return the signal at which the variance is largest; None if it never falls after that."""
    top = float(points.signal.max())
    step = np.floor(points.signal / (_STEP * top)).astype(np.intp).clip(0)
    weight = np.bincount(step, weights=points.freedom)
    filled = np.flatnonzero(weight)
    signal, variance = (
        np.bincount(step, weights=points.freedom * values)[filled] / weight[filled]
        for values in (points.signal, points.variance)
    )
    peak = int(np.argmax(variance))
    if not np.any(variance[peak:] < _FALLEN * variance[peak]):
        return None
    near = signal[max(0, peak - 1) : peak + 2]
    return Saturation(float(signal[peak]), float(np.ptp(near)) / 12**0.5)


@dataclass(frozen=True)
class Gain:
    """System gain and temporal noise in the dark, DN^2."""

    dn_per_e: float
    sigma: float
    dark_variance: float
    dark_variance_sigma: float

    def in_electrons(self, found: Measured) -> Measured:
        """Return a value in DN in electrons; its error includes that of the gain."""
        sigma = float(np.hypot(found.sigma, found.value * self.sigma / self.dn_per_e))
        return Measured(found.value / self.dn_per_e, sigma / self.dn_per_e)


def fit_gain(points: Points, dark: DarkFrames, top: float) -> Gain:
    """Fit the variance above that of the dark, in proportion to the signal.

    Parameters
    ----------
    points
        The photon-transfer curve.
    dark
        Dark frames; their dark current has shot noise too.
    top
        Signal at saturation.

    Raises
    ------
    EstimateError
        If too few exposures are below saturation, or the variance does not rise with the signal.
    """
    use = (points.signal < _GAIN_TO * top) & (points.signal > 0) & (points.freedom > 0)
    exposures = len(np.unique(points.time_s[use]))
    if exposures < _FEWEST_EXPOSURES:
        raise EstimateError(
            f"only {exposures} of {len(np.unique(points.time_s))} exposures are below 70 % of "
            f"saturation, at least {_FEWEST_EXPOSURES} are necessary: record shorter exposure times"
        )
    signal, variance, freedom = points.signal[use], points.variance[use], points.freedom[use]
    current = np.maximum(dark.current_dn_per_s * points.time_s[use], 0.0)
    gain, model = 0.0, variance
    for _ in range(5):
        weight = freedom / (2 * np.maximum(model, 1e-6) ** 2)
        floor = dark.variance(gain) + gain * current
        information = float(weight @ signal**2)
        gain = float(weight @ (signal * (variance - floor))) / information
        model = floor + gain * signal
        if not gain > 0:
            raise EstimateError(
                "the noise does not grow with the light: the frames were processed, or are copies"
            )
    excess = float(weight @ (variance - model) ** 2) / max(1, len(signal) - 1)
    samples = dark.free * int(dark.good.sum())
    return Gain(
        gain,
        (max(1.0, excess) / information) ** 0.5,
        dark.variance(gain),
        (2 / samples) ** 0.5 * dark.residual / dark.free,
    )


@dataclass(frozen=True)
class FullWell:
    """Signal of saturated samples above black, DN, and what saturates."""

    signal: float
    sigma: float
    limit: Literal["converter", "pixel"]


def full_well(points: Points, dark: DarkFrames, top: float) -> FullWell | None:
    """Return the signal of zones that are certainly saturated; None without one."""
    largest = float(points.signal.max())
    low = points.signal < _GAIN_TO * top
    squares = np.bincount(points.zone[low], points.time_s[low] ** 2)
    product = np.bincount(points.zone[low], (points.signal * points.time_s)[low])
    slope = product / np.maximum(squares, 1e-30)
    expected = np.zeros_like(points.signal)
    known = points.zone < len(slope)
    expected[known] = slope[points.zone[known]] * points.time_s[known]
    full = expected > _FULL * largest
    if not full.any():
        return None
    # Dark current fills the pixels, too.
    signal = points.signal[full] + dark.current_dn_per_s * points.time_s[full]
    weight = points.freedom[full] / points.freedom[full].sum()
    mean = float(weight @ signal)
    sigma = float(weight @ (signal - mean) ** 2) ** 0.5 / len(signal) ** 0.5
    white = float(weight @ points.white[full])
    return FullWell(mean, sigma, "converter" if white > 0.5 else "pixel")


@dataclass(frozen=True, eq=False)
class Linearity:
    """Relative deviation from straight lines, by signal.

    Parameters
    ----------
    signal
        ``(B,)`` signal, DN.
    deviation
        ``(B,)`` mean relative deviation of the zones.
    error
        Mean of the absolute deviations.
    """

    signal: Float64
    deviation: Float64
    error: Measured


def linearity(points: Points, top: float, flicker: float) -> Linearity:
    """Fit a straight line to the signal of each zone over exposure time.

    Squares of the relative deviations are minimised, as in EMVA 1288; deviations are averaged in
    steps of the signal, so that zones of different brightness show the same response.

    Parameters
    ----------
    points
        The photon-transfer curve.
    top
        Signal at saturation.
    flicker
        Relative standard deviation of the light of an exposure.

    Raises
    ------
    EstimateError
        If no zone has three exposures in the range.
    """
    use = (points.signal > _LINE_FROM * top) & (points.signal < _LINE_TO * top)
    signals, deviations, noises = [], [], []
    for zone in np.unique(points.zone[use]):
        of_zone = use & (points.zone == zone)
        time, signal = points.time_s[of_zone], points.signal[of_zone]
        if len(time) < 3:
            continue
        design = np.stack([np.ones_like(time), time], axis=1)
        line, *_ = np.linalg.lstsq(design / signal[:, None], np.ones_like(time), rcond=None)
        fitted = design @ line
        signals.append(signal)
        deviations.append(signal / fitted - 1)
        noises.append(points.variance[of_zone] / points.freedom[of_zone] / signal**2)
    if not signals:
        raise EstimateError(
            "no zone has three exposures between 5 % and 95 % of saturation: record more brackets"
        )
    signal, deviation, noise = map(np.concatenate, (signals, deviations, noises))
    step = np.floor(signal / (_LINE_STEP * top)).astype(np.intp)
    count = np.bincount(step)
    filled = np.flatnonzero(count)
    count = count[filled]
    means, level, error = (
        np.bincount(step, values)[filled] / count for values in (deviation, signal, noise)
    )
    sigma = float(np.mean(error / count) + flicker**2) ** 0.5 / len(filled) ** 0.5
    return Linearity(level, means, Measured(float(np.mean(np.abs(means))), sigma))


def read_noise(gain: Gain) -> Measured:
    """Return the temporal noise in the dark without quantisation, electrons."""
    return gain.in_electrons(root(gain.dark_variance - _QUANTISATION, gain.dark_variance_sigma))


def root(squared: float, sigma: float) -> Measured:
    """Return the root of a variance; near 0, its deviation is limited by that of the variance."""
    return Measured(max(squared, 0.0) ** 0.5, sigma / (2 * max(squared, sigma) ** 0.5))
