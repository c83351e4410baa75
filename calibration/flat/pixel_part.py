"""The pixel part of a flat from one or more recordings of a card."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.flat.sites import Sites
from rig.arrays import Bool, Float32, Float64

# Values of two recordings that differ by more standard deviations show a stain of the card.
_STAIN = 5.0
_ROWS = 128
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

    values: Float32
    std: float
    prnu: float
    card_std: float | None
    stains: int
    dead: int


def combine(
    parts: Sequence[Float32], variances: Sequence[Float32], measured: Sequence[Bool], sites: Sites
) -> PixelPart:
    """Average recordings of a card that was moved between them.

    Parameters
    ----------
    parts
        S responses over their smooth parts, each the shape of the frames.
    variances
        Their relative variances.
    measured
        Where they were measured.
    sites
        Colours of the pixels; the mean of each is 1.
    """
    levels = [_levels(part, on, sites) for part, on in zip(parts, measured, strict=True)]
    spread, texture = 0.0, None
    if len(parts) > 1:
        both = measured[0] & measured[1]
        spread = _spread(parts, levels, both, sites)
        noise_of_two = sum(float(np.median(of_one[both])) for of_one in variances[:2])
        texture = float(np.sqrt(max(spread**2 - noise_of_two, 0.0) / 2 / len(parts)))
    result, total = np.ones(sites.shape, np.float32), np.zeros(sites.shape, np.float32)
    stains = 0
    for top in range(0, sites.shape[0], _ROWS):
        rows = slice(top, min(top + _ROWS, sites.shape[0]))
        values = _levelled(parts, levels, sites, rows)
        on = np.stack([of_one[rows] for of_one in measured])
        least = np.maximum(np.stack([of_one[rows] for of_one in variances]), 1e-12)
        precision = np.where(on, 1 / least, 0.0)
        total[rows] = precision.sum(axis=0)
        weighted = (precision * values).sum(axis=0)
        mean = weighted / np.where(total[rows] > 0, precision.sum(axis=0), 1.0)
        if len(parts) > 1:
            apart = values.max(axis=0) - values.min(axis=0)
            stained = on.all(axis=0) & (apart > _STAIN * max(spread, 1e-9))
            nearest = np.abs(values - 1).argmin(axis=0)[None]
            mean = np.where(stained, np.take_along_axis(values, nearest, axis=0)[0], mean)
            stains += int(stained.sum())
        result[rows] = mean
    known = total > 0
    noise = 1 / float(np.median(total[known]))
    dead = known & (result < _DEAD)
    keep = known & ~dead
    spread_of_all = float(np.std(result[keep], dtype=np.float64)) ** 2
    spread_of_all -= noise + (texture or 0.0) ** 2
    result[~keep] = 1
    return PixelPart(
        result,
        float(np.sqrt(noise)),
        float(np.sqrt(max(spread_of_all, 0.0))),
        texture,
        stains,
        int(dead.sum()),
    )


def _levels(part: Float32, where: Bool, sites: Sites) -> Float64:
    """Return the mean of each colour: neither exposure nor colours are part of a flat."""
    means = np.ones(sites.colours)
    for c in range(sites.colours):
        on = sites.colour(where, c) & sites.has(c)
        if on.any():
            means[c] = float(np.mean(sites.colour(part, c)[on], dtype=np.float64))
    return means


def _levelled(
    parts: Sequence[Float32], levels: Sequence[Float64], sites: Sites, rows: slice
) -> Float64:
    """Return some rows of the parts, ``(S, rows, ...)``, divided by their levels."""
    pairs = zip(parts, levels, strict=True)
    return np.stack([part[rows] / sites.of_pixels(level, rows) for part, level in pairs])


def _spread(parts: Sequence[Float32], levels: Sequence[Float64], both: Bool, sites: Sites) -> float:
    """Return the robust standard deviation of the difference between the first two parts."""
    differences = []
    for top in range(0, sites.shape[0], _ROWS):
        rows = slice(top, min(top + _ROWS, sites.shape[0]))
        first, second = _levelled(parts[:2], levels[:2], sites, rows)
        differences.append((first - second)[both[rows]].astype(np.float32))
    values = np.concatenate(differences)
    if not values.size:
        return 0.0
    values -= np.median(values)
    return 1.4826 * float(np.median(np.abs(values, out=values), overwrite_input=True))
