"""Zones of nearly equal light, and variation of the pixels around their neighbours."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import row_bands

Image = npt.NDArray[np.float32]
Labels = npt.NDArray[np.int16]

# Side of the box whose mean is the light at its middle, in pixels of one colour.
BOX = 11
_MOST_ZONES = 12
_FEWEST_PIXELS = 400
_NO_ZONE = -1
# Rows with about this number of pixels show the distribution of the light.
_SAMPLE = 2_000_000


def site_slices(cfa: str | None) -> list[tuple[slice, slice]]:
    """Return the pixels of each colour filter of a mosaic; all pixels without a mosaic."""
    if cfa is None:
        return [(slice(None), slice(None))]
    return [(slice(row, None, 2), slice(column, None, 2)) for row in (0, 1) for column in (0, 1)]


def zone_labels(signal: Image, good: npt.NDArray[np.bool_], cfa: str | None) -> tuple[Labels, int]:
    """Divide the pixels into zones by the light that they get.

    Parameters
    ----------
    signal
        ``(H, W)`` image of the field, above dark.
    good
        ``(H, W)`` pixels to use.
    cfa
        Colour filter; pixels of different filters are in different zones.

    Returns
    -------
    labels
        ``(H, W)`` zone of each pixel; -1 for pixels that are not used: not good, or near the edge.
    count
        Number of zones.
    """
    labels = np.full(signal.shape, _NO_ZONE, np.int16)
    count = 0
    for site in site_slices(cfa):
        light = smooth(signal[site])
        inner = np.zeros(light.shape, np.bool_)
        margin = BOX // 2
        inner[margin:-margin, margin:-margin] = True
        inner &= good[site]
        pixels = int(inner.sum())
        zones = max(1, min(_MOST_ZONES, pixels // _FEWEST_PIXELS))
        step = max(1, pixels // _SAMPLE)
        edges = np.quantile(light[::step][inner[::step]], np.arange(1, zones) / zones)
        of_site = labels[site]
        for rows in row_bands(len(light)):
            found = count + np.searchsorted(edges, light[rows])
            of_site[rows] = np.where(inner[rows], found, _NO_ZONE)
        count += zones
    return labels, count


def smooth(image: Image) -> Image:
    """Return the mean of a box around each pixel."""
    compact = np.ascontiguousarray(image)
    smoothed = cv2.blur(compact, (BOX, BOX), borderType=cv2.BORDER_REFLECT)
    return np.asarray(smoothed, np.float32)


def relative_pattern(signal: Image, good: npt.NDArray[np.bool_], cfa: str | None) -> Image:
    """Return the relative deviation of each pixel from the mean of the box around it.

    The box removes the field of the light. White noise of variance s^2 in the pixels has the
    variance (1 - 1 / box^2) s^2 in the result. Pixels that are not good count as the median of
    their neighbours.
    """
    pattern = np.zeros_like(signal)
    for site in site_slices(cfa):
        raw = np.ascontiguousarray(signal[site])
        values: Image = np.where(good[site], raw, cv2.medianBlur(raw, 5)).astype(np.float32)
        light = smooth(values)
        pattern[site] = values / np.maximum(light, np.float32(1e-6)) - 1
    return pattern
