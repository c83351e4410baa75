"""Noise of single frames as a function of their signal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import LINEAR, Frame, NoiseModel, Source
from acquisition.source import Linearizer, row_bands
from calibration.radiance.brackets import Law
from rig.arrays import Float64

_PAIRS = 6
_BINS = 40
_PIXELS = 400_000
# Samples this close to white may be clipped.
_MOST = 0.85
# Variance of the signals, relative to that of the noise, that is necessary.
_SPREAD = 20.0
# The slope is known if its standard deviation is a fraction of it.
_KNOWN = 0.1


@dataclass(frozen=True)
class SignalNoise:
    """Variance of a frame at signal s, 1 at white: ``shot * (s - offset) + constant``.

    Here the signal contains dark current and the light of the room. ``origin`` is ``sensor`` or
    ``repeats``. ``offset`` is the signal without electrons: 0 if the black level is known.
    """

    shot: float
    constant: float
    origin: str
    offset: float = 0.0

    @property
    def of_frame(self) -> Law:
        """Law of a single frame, as a function of the whole signal."""
        return Law(self.shot, self.constant - self.shot * self.offset)

    def law(self, share: float, repeats: int, level: float, references: int) -> Law:
        """Return the law of the mean of repeats, less the mean of references, over the exposure.

        Parameters
        ----------
        share
            Exposure time relative to the longest.
        repeats
            Number of frames in the mean.
        level
            Signal without the LED, which is subtracted.
        references
            Number of frames whose mean is subtracted; 0 if nothing is.
        """
        dark = (self.shot * max(level - self.offset, 0.0) + self.constant) / share**2
        common = dark / references if references else 0.0
        return Law(self.shot / (share * repeats), dark / repeats + common)


def signal_noise(source: Source, linear: Linearizer) -> SignalNoise | None:
    """Return the noise of a source, from its sensor or its repeats; None if neither determines it.

    The noise of samples with a transfer curve is unknown.
    """
    if source.transfer != LINEAR or not np.isfinite(source.white_level):
        return None
    if source.noise is not None:
        return _of_sensor(source, source.noise, linear)
    pairs = _repeats(source)
    return _of_repeats(pairs, linear, source.black_level) if pairs else None


def _of_sensor(source: Source, noise: NoiseModel, linear: Linearizer) -> SignalNoise:
    span_dn = source.white_level - source.black_level
    gain_span = noise.electrons_per_dn * span_dn
    constant = (noise.read_noise_e / gain_span) ** 2 + 1 / (12 * span_dn**2)
    offset = 0.0 if source.black_level else _dark_offset(source, noise, linear)
    return SignalNoise(1 / gain_span, constant, "sensor", offset)


def _dark_offset(source: Source, noise: NoiseModel, linear: Linearizer) -> float:
    """Return the signal of dark frames without dark current; 0 without dark frames.

    Sensors have a black level above 0, so a stated black level of 0 is one that was not known.
    """
    offsets = []
    times_us = {frame.exposure_us for frame in source.frames if frame.role == "light"}
    for time_us in sorted(times_us, key=lambda time_us: time_us or 0.0):
        dark = linear.dark_signal(time_us)
        if dark is not None:
            current_e = noise.dark_current_e_per_s * (time_us or 0.0) / 1e6
            current = current_e / (noise.electrons_per_dn * source.white_level)
            offsets.append(float(np.median(dark[::5])) - current)
    return max(min(offsets, default=0.0), 0.0)


def _repeats(source: Source) -> list[tuple[Frame, Frame]]:
    """Return pairs of repeats of different lights, spread over the recording."""
    groups: dict[tuple[str, int], list[Frame]] = {}
    for frame in source.frames:
        if frame.role == "light":
            groups.setdefault((frame.light_id, frame.bracket), []).append(frame)
    pairs = [(group[0], group[1]) for group in groups.values() if len(group) > 1]
    return [pairs[i] for i in range(0, len(pairs), max(1, len(pairs) // _PAIRS))]


def _of_repeats(
    pairs: list[tuple[Frame, Frame]], linear: Linearizer, black_level: float
) -> SignalNoise | None:
    """Fit the variance of differences against the signal; None if they do not determine it.

    The variance without light may not be negative. If the black level is not known, the lowest
    level of the references stands for it: its shot noise is part of the constant.
    """
    signals, squares = zip(*(_differences(one, other, linear) for one, other in pairs), strict=True)
    signal, difference = np.concatenate(signals), np.concatenate(squares)
    order = np.argsort(signal)
    parts = [part for part in np.array_split(order, _BINS) if len(part) > 100]
    if len(parts) < 3:
        return None
    level = np.array([signal[part].mean() for part in parts])
    variance = np.array([_variance(difference[part]) for part in parts])
    count = np.array([len(part) for part in parts])
    # If all signals are alike, noise alone assigns the samples to the bins.
    if not variance.min() > 0 or np.var(signal) < _SPREAD * np.median(variance):
        return None
    levels = [linear.reference_level(one.exposure_us)[0] for one, _ in pairs]
    offset = 0.0 if black_level else max(min(levels), 0.0)
    # Imported here: scipy.optimize takes 0.4 s, and most recordings state their sensor.
    from scipy.optimize import nnls

    design = np.stack([level - offset, np.ones_like(level)], axis=1)
    fitted = variance
    for _ in range(3):
        sigma = fitted * np.sqrt(2 / count)
        coefficients, _ = nnls(design / sigma[:, None], variance / sigma)
        fitted = np.maximum(design @ coefficients, variance.min() / 4)
    covariance = np.linalg.inv((design / sigma[:, None]).T @ (design / sigma[:, None]))
    if not coefficients[0] > covariance[0, 0] ** 0.5 / _KNOWN:
        return None
    return SignalNoise(float(coefficients[0]), float(coefficients[1]), "repeats", offset)


def _differences(one: Frame, other: Frame, linear: Linearizer) -> tuple[Float64, Float64]:
    """Return mean signal above black and scaled difference of samples of two frames.

    Variances of the differences are those of a single frame. The second frame is scaled by the
    ratio of both, since lamps flicker.
    """
    a, b = linear.pixels(one), linear.pixels(other)
    rows = row_bands(len(a))[:: max(1, a.size // _PIXELS)]
    x = np.concatenate([linear.part(one, a, (band, slice(None)))[0].ravel() for band in rows])
    y = np.concatenate([linear.part(other, b, (band, slice(None)))[0].ravel() for band in rows])
    level, _ = linear.reference_level(one.exposure_us)
    mean = (x + y) / 2
    use = mean + level < _MOST
    x, y, mean = (of_one[use].astype(np.float64) for of_one in (x, y, mean))
    bright = mean > np.median(mean) if mean.size else use
    ratio = float(x[bright].sum() / y[bright].sum()) if np.any(bright) else 1.0
    return mean + level, (x - ratio * y) / (1 + ratio**2) ** 0.5


def _variance(differences: Float64) -> float:
    """Return the variance without samples far outside, for example of a moved edge."""
    limit = 6 * 1.4826 * float(np.median(np.abs(differences))) + 1e-9
    inside = differences[np.abs(differences) <= limit]
    return float(np.mean(inside**2))
