"""Highlights that are larger or smaller than those of the other lights on a sphere."""

from __future__ import annotations

import numpy as np

from calibration._spheres.robust import Array

_FEWEST = 5
# Of the logarithm of the areas: their usual scatter at least, and how many times it is unusual.
_SCATTER, _UNUSUAL = 0.03, 3.0


def unlike_px(radii_px: Array) -> Array:
    """Return by how much highlights may be off because their sizes differ from the others, in px.

    The image of a lamp in a mirror ball has the same area wherever it is: toward the rim it becomes
    narrower by as much as it becomes longer. Therefore, a highlight that is larger than the others
    contains a reflection, and a smaller one is a part of a highlight or a reflection. If what is
    too much or missing is on one side, the centre is off by about its share of the area times the
    radius.

    Parameters
    ----------
    radii_px
        ``(N,)`` radii of discs with the areas of the highlights of N lights, NaN without one.

    Returns
    -------
    Array
        ``(N,)`` standard deviation of each coordinate; 0 if the size is usual, or if fewer than
        five are known.
    """
    off = np.zeros(len(radii_px))
    known = np.flatnonzero(radii_px > 0)
    if len(known) < _FEWEST:
        return off
    logs = 2 * np.log(radii_px[known])
    middle = float(np.median(logs))
    away = np.abs(logs - middle)
    unusual = away > _UNUSUAL * (_SCATTER + 1.4826 * float(np.median(away)))
    mean_px = (radii_px[known] + np.exp(middle / 2)) / 2
    off[known] = np.where(unusual, (1 - np.exp(-away)) * mean_px / np.sqrt(2), 0.0)
    return off
