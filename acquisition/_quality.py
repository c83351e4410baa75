"""How good a raw frame is, in numbers an operator can act on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

# Per mille, so that ranks are whole-number arithmetic.
_PERCENTILES = {"1": 10, "50": 500, "99": 990, "99.9": 999}
# Rows at a time: the temporaries stay in the cache.
_BAND = 64


@dataclass(frozen=True)
class FrameQuality:
    """Figures of one frame, on raw values over the full frame.

    Parameters
    ----------
    clipped_fraction
        Share of samples at or above the white level, 0 to 1.
    percentiles_dn
        Smallest grey value that at least this percentage of samples does not exceed; ``0`` and
        ``100`` are the least and the greatest.
    sharpness
        Mean squared difference of samples two apart, along rows and columns, over the squared mean
        grey value above black (Brenner et al. 1976). Samples two apart have the same colour under
        a Bayer filter. Comparable between frames of one scene and exposure only; 0 for a frame
        that is black.
    """

    clipped_fraction: float
    percentiles_dn: dict[str, int]
    sharpness: float


def measure_quality(
    pixels: npt.NDArray[np.uint16], *, white_level_dn: float, black_level_dn: float = 0.0
) -> FrameQuality:
    """Measure a raw frame.

    Parameters
    ----------
    pixels
        ``(H, W)`` or ``(H, W, 3)`` raw values.
    white_level_dn
        Grey value from which a sample is clipped.
    black_level_dn
        Grey value without light.

    Returns
    -------
    FrameQuality
        Exact counts; the sharpness to six significant digits.
    """
    counts = np.zeros(65536, np.int64)
    for top in range(0, len(pixels), _BAND):
        counts += np.bincount(pixels[top : top + _BAND].ravel(), minlength=65536)
    ranks = np.cumsum(counts)
    total = int(ranks[-1])
    occupied = np.flatnonzero(counts)
    percentiles = {"0": int(occupied[0])}
    for name, per_mille in _PERCENTILES.items():
        percentiles[name] = int(np.searchsorted(ranks, -(-per_mille * total // 1000)))
    percentiles["100"] = int(occupied[-1])
    clipped = counts[int(np.ceil(max(white_level_dn, 0))) :].sum()
    mean = float(counts @ np.arange(65536)) / total - black_level_dn
    energy = _brenner(pixels)
    sharpness = energy / mean**2 if mean > 0 else 0.0
    return FrameQuality(float(clipped / total), percentiles, float(f"{sharpness:.6g}"))


def _brenner(pixels: npt.NDArray[np.uint16]) -> float:
    total, count = 0, 0
    for top in range(0, len(pixels), _BAND):
        # Two rows more than the band, so that every vertical pair is seen once.
        band = pixels[top : top + _BAND + 2].astype(np.int64)
        along = band[:_BAND, 2:] - band[:_BAND, :-2]
        down = band[2:] - band[:-2]
        total += int(np.vdot(along, along)) + int(np.vdot(down, down))
        count += along.size + down.size
    return total / count if count else 0.0
