"""The quality figures of a raw frame."""

from __future__ import annotations

from dataclasses import dataclass

PERCENTILE_NAMES = ("0", "1", "50", "99", "99.9", "100")


@dataclass(frozen=True)
class FrameQuality:
    """Quality figures of one frame, computed from the raw values of the full frame.

    Parameters
    ----------
    clipped_fraction
        Share of samples at or above the white level, 0 to 1.
    percentiles_dn
        Smallest grey value that at least this percentage of samples does not exceed; ``0`` and
        ``100`` are the minimum and the maximum.
    sharpness
        Mean squared difference of samples two apart, along rows and columns, over the squared mean
        grey value above black (Brenner et al. 1976). Samples two apart have the same colour under
        a Bayer filter. Comparable only between frames of the same scene and exposure; 0 for a
        black frame.
    mean_dn
        Mean grey value; None for a frame of a session that does not record it.
    """

    clipped_fraction: float
    percentiles_dn: dict[str, int]
    sharpness: float
    mean_dn: float | None


def above_dark(lit: FrameQuality, dark: FrameQuality | None, range_dn: float) -> float | None:
    """Return how far the mean of a frame is above that of a dark frame, relative to the range.

    The result is rounded to a millionth, or None if one of the means is not known.
    """
    if dark is None or lit.mean_dn is None or dark.mean_dn is None:
        return None
    return round((lit.mean_dn - dark.mean_dn) / range_dn, 6)
