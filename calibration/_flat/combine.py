"""The pixel part of a flat from one or more recordings of a card."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calibration._flat.sites import Array, Bools, Sites

# Values of two recordings that differ by more standard deviations show a stain of the card.
_STAIN = 5.0
# Below this share of its surroundings a pixel is dead, or behind something opaque.
_DEAD = 0.2


@dataclass(frozen=True, eq=False)
class PixelPart:
    """The pixel part of a flat.

    Parameters
    ----------
    values
        Float32, mean 1; 1 where not measured.
    std
        Standard deviation by temporal noise, of the median pixel.
    prnu
        Standard deviation among the pixels, without that of the noise; with one recording, the
        texture of the card is in it.
    card_std
        Standard deviation of the texture of the card that is left; None with one recording.
    stains, dead
        Numbers of pixels at which recordings differ, and that do not respond.
    """

    values: npt.NDArray[np.float32]
    std: float
    prnu: float
    card_std: float | None
    stains: int
    dead: int


def combine(
    parts: Sequence[Array],
    variances: Sequence[npt.NDArray[np.float32]],
    measured: Bools,
    sites: Sites,
) -> PixelPart:
    """Average recordings of a card that was moved between them.

    Parameters
    ----------
    parts
        S responses over their smooth parts, each the shape of the frames.
    variances
        Their relative variances.
    measured
        ``(S, ...)`` bool, where they were measured.
    sites
        Colours of the pixels; the mean of each is 1.
    """
    where = measured
    values = np.stack([_levelled(part, on, sites) for part, on in zip(parts, where, strict=True)])
    precision = np.where(where, 1 / np.maximum(np.stack(variances), 1e-12), 0.0)
    total = precision.sum(axis=0)
    known = total > 0
    mean = (precision * np.where(where, values, 0.0)).sum(axis=0) / np.where(known, total, 1.0)
    noise = 1 / np.median(total[known])
    card, stains = None, 0
    if len(parts) > 1:
        both = where.all(axis=0)
        highest, lowest = values.max(axis=0), values.min(axis=0)
        difference = values[0] - values[1]
        spread = _robust_std(difference[both])
        stained = both & (highest - lowest > _STAIN * max(spread, 1e-9))
        nearest = np.take_along_axis(values, np.abs(values - 1).argmin(axis=0)[None], axis=0)[0]
        mean = np.where(stained, nearest, mean)
        stains = int(stained.sum())
        of_noise = sum(float(np.median(of_one[both])) for of_one in variances[:2])
        texture = max(spread**2 - of_noise, 0.0) / 2
        card = float(np.sqrt(texture / len(parts)))
    dead = known & (mean < _DEAD)
    keep = known & ~dead
    spread_of_all = float(np.std(mean[keep])) ** 2 - noise - (card or 0.0) ** 2
    result = np.where(keep, mean, 1.0)
    return PixelPart(
        result.astype(np.float32),
        float(np.sqrt(noise)),
        float(np.sqrt(max(spread_of_all, 0.0))),
        card,
        stains,
        int(dead.sum()),
    )


def _levelled(part: Array, where: Bools, sites: Sites) -> Array:
    """Divide each colour by its mean: neither exposure nor colours are part of a flat."""
    means = np.ones(sites.colours)
    for c in range(sites.colours):
        plane, on = sites.colour(part, c), sites.colour(where, c)
        on = on & sites.has(c)
        means[c] = float(np.mean(plane[on])) if on.any() else 1.0
    return part / np.broadcast_to(sites.of_pixels(means), part.shape)


def _robust_std(values: Array) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if values.size else 0.0
