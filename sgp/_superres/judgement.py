"""How good a network is on surfaces that it was not trained on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sgp._superres.losses import results, squared_angle, squared_chord
from sgp._superres.pair_files import PairFiles
from sgp._superres.rdn import RdnSize
from sgp._superres.torch_layers import as_images, forward

if TYPE_CHECKING:
    import torch

_EVERY = 5  # one pixel in so many counts toward the deciles
_DECILES = 10
# No predicted deviation is above 1 radian: extrapolated ones would outweigh all others.
_LARGEST_LOG = 0.0


@dataclass(frozen=True)
class Judgement:
    """Errors on held-out surfaces, in degrees, and how well they were predicted.

    Parameters
    ----------
    bicubic_deg, network_deg
        Mean angular errors of bicubic interpolation and of the network.
    actual_over_predicted
        Root mean square of the network's errors over that of its predictions, for each tenth of
        the pixels in order of the prediction; 1 is best.
    bicubic_actual_over_predicted
        The same for the errors of bicubic interpolation.
    """

    bicubic_deg: float
    network_deg: float
    actual_over_predicted: tuple[float, ...]
    bicubic_actual_over_predicted: tuple[float, ...]

    @property
    def change(self) -> float:
        """The network's error relative to that of bicubic interpolation, minus 1."""
        return self.network_deg / self.bicubic_deg - 1


def judge(size: RdnSize, weights: Mapping[str, torch.Tensor], pairs: PairFiles) -> Judgement:
    """Return the errors of a network over complete surfaces."""
    import torch

    errors: list[list[npt.NDArray[np.float32]]] = [[], []]
    logs: list[list[npt.NDArray[np.float32]]] = [[], []]
    for index, image in enumerate(pairs.low):
        low, high = (as_images(one[None]) for one in pairs.crop(index, 0, 0, len(image)))
        with torch.no_grad():
            output = forward(size, weights, low.to(weights["last.bias"].device)).cpu()
            for kind, normals in enumerate(results(low, output, size.scale)):
                squares = squared_angle(squared_chord(normals, high))
                errors[kind].append(squares.sqrt().numpy().ravel())
                log = output[:, 4 - kind].clamp(max=_LARGEST_LOG)
                logs[kind].append(log.numpy().ravel())
    bicubic, network = (np.concatenate(one) for one in errors)
    return Judgement(
        _mean_deg(bicubic),
        _mean_deg(network),
        _ratios(network, np.concatenate(logs[1])),
        _ratios(bicubic, np.concatenate(logs[0])),
    )


def _mean_deg(angles: npt.NDArray[np.float32]) -> float:
    return math.degrees(float(angles.mean(dtype=np.float64)))


def _ratios(angles: npt.NDArray[np.float32], logs: npt.NDArray[np.float32]) -> tuple[float, ...]:
    """Return actual over predicted deviation by deciles of the prediction."""
    actual, predicted = angles[::_EVERY].astype(np.float64) ** 2, np.exp(logs[::_EVERY])
    deciles = np.array_split(np.argsort(predicted, kind="stable"), _DECILES)
    return tuple(
        math.sqrt(float(actual[one].mean() / predicted[one].mean(dtype=np.float64)))
        for one in deciles
    )
