"""How good a network is on surfaces that it was not trained on, and how well it knows that."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

import acquisition
import processing
import rig
import simulator
from rig.arrays import Float32, Float64, Floating
from sgp.training.presets import RUGGED_SCALES


def surface(seed: int, side: int, scale: int) -> Float32:
    """Return normals to judge a network on, of the kinds that its training had.

    They are random ones, at scale 4 rugged ones for odd seeds.

    Parameters
    ----------
    seed
        Fixes everything.
    side
        Side of the square in pixels.
    scale
        Scale of the network.
    """
    rugged = scale in RUGGED_SCALES and seed % 2
    make = simulator.reliefs.rugged_normals if rugged else simulator.random_normals
    return make(seed, side)


_EVERY = 2  # one row and column in so many counts toward the deviations
_DECILES = 10
_LEAST_DEG = 1e-6
# Shares of the pixels, in order of the prediction, between which the deviations are compared: few
# at the ends, where predictions are extrapolated.
_SHARES = (
    *(0, 0.01, 0.03, 0.06, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9),
    *(0.95, 0.98, 0.99, 0.997, 1),
)


@dataclass(frozen=True, eq=False)
class Measured:
    """Errors of a network on random surfaces, all in degrees.

    Parameters
    ----------
    bicubic_deg, network_deg
        Mean angular errors of bicubic interpolation, and of the result with the network.
    predicted_deg, actual_deg
        ``(N,)`` predicted deviations of the result and its angular errors at some pixels, in
        order of the prediction.
    """

    bicubic_deg: float
    network_deg: float
    predicted_deg: Float32
    actual_deg: Float64


@dataclass(frozen=True)
class Judgement:
    """Errors on held-out surfaces, in degrees, and how well they were predicted.

    Parameters
    ----------
    bicubic_deg, network_deg
        As in `Measured`.
    actual_over_predicted
        Root mean square of the errors over that of the predictions, for each tenth of the pixels
        in order of the prediction; 1 is best.
    """

    bicubic_deg: float
    network_deg: float
    actual_over_predicted: tuple[float, ...]

    @property
    def change(self) -> float:
        """The network's error relative to that of bicubic interpolation, minus 1."""
        return self.network_deg / self.bicubic_deg - 1


def measure(
    model: processing.SuperResolutionModel,
    seeds: range,
    side: int,
    name: str,
    on_progress: rig.Progress,
    *,
    self_ensemble: bool | None = None,
) -> Measured:
    """Reduce random surfaces, enlarge them as `sgp detail superres` does, and compare.

    Parameters
    ----------
    model
        The network.
    seeds
        Seeds of the surfaces.
    side
        Side of the surfaces in pixels.
    name
        Stage of the progress.
    on_progress
        Receives the stage `name`, one step per surface.
    self_ensemble
        As in `processing.super_resolve`.
    """
    means: list[tuple[float, float]] = []
    predicted, actual = [], []
    on_progress(name, 0, len(seeds))
    for done, seed in enumerate(seeds, 1):
        truth = processing.NormalMap.from_vectors(surface(seed, side, model.scale))
        low = processing.superres.low_resolution(truth, model.scale)
        plain = processing.super_resolve(low, model.scale, method="bicubic", mask=truth.mask)
        made = processing.super_resolve(
            low, model.scale, model=model, self_ensemble=self_ensemble, mask=truth.mask
        )
        angles = acquisition.angle_deg(made.normal_map.normals, truth.normals)
        bicubic = acquisition.angle_deg(plain.normal_map.normals, truth.normals)
        means.append((float(bicubic.mean()), float(angles.mean())))
        if made.sigma_deg is not None:  # it is, with a network
            predicted.append(made.sigma_deg[::_EVERY, ::_EVERY].ravel())
        actual.append(angles[::_EVERY, ::_EVERY].ravel())
        on_progress(name, done, len(seeds))
    deviations, errors = np.concatenate(predicted), np.concatenate(actual)
    order = np.argsort(deviations, kind="stable")
    bicubic_deg, network_deg = np.mean(means, axis=0).tolist()
    return Measured(bicubic_deg, network_deg, deviations[order], errors[order])


def judged(measured: Measured) -> Judgement:
    """Return the figures of a network."""
    parts = np.array_split(np.arange(len(measured.predicted_deg)), _DECILES)
    ratios = tuple(
        _rms(measured.actual_deg[part]) / _rms(measured.predicted_deg[part]) for part in parts
    )
    return Judgement(measured.bicubic_deg, measured.network_deg, ratios)


def fitted_deviations(measured: Measured) -> processing.superres.Deviations | None:
    """Return the actual deviations of parts of the pixels with similar predictions.

    None if all predictions are the same, as those of a network without training.
    """
    cuts = np.round(np.array(_SHARES) * len(measured.predicted_deg)).astype(int)
    predicted: list[float] = []
    actual: list[float] = []
    for first, last in pairwise(cuts):
        logs = np.log(measured.predicted_deg[first:last].astype(np.float64))
        centre = float(np.exp(logs.mean())) if last > first else 0.0
        if centre > (predicted[-1] if predicted else 0):
            predicted.append(centre)
            least = actual[-1] if actual else _LEAST_DEG
            actual.append(max(_rms(measured.actual_deg[first:last]), least))
    if len(predicted) < 2:
        return None
    return processing.superres.Deviations(tuple(predicted), tuple(actual))


def _rms(values: Floating) -> float:
    return float(np.sqrt(np.mean(values.astype(np.float64) ** 2)))
