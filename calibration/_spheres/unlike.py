"""Highlights that are larger or smaller than those of the other lights on a sphere."""

from __future__ import annotations

import numpy as np

from calibration._spheres.robust import Array

_FEWEST = 5
# Of the logarithm of the areas: their usual scatter at least, and how many times it is unusual.
_SCATTER, _UNUSUAL = 0.05, 3.0


def unlike_px(areas: Array) -> Array:
    """Return by how much highlights may be off because their areas differ from the others, in px.

    The image of a lamp in a mirror ball has the same area wherever it is: toward the rim it becomes
    narrower by as much as it becomes longer. Therefore, a highlight that is larger than the others
    contains a reflection, and a smaller one is a part of a highlight or a reflection. If what is
    too much or missing is on one side, the centre is off by its share of the area times the
    distance of the centres of two discs.

    Parameters
    ----------
    areas
        ``(N,)`` areas of the highlights of N lights in px^2, NaN where there is none.

    Returns
    -------
    Array
        ``(N,)`` standard deviation of each coordinate; 0 if the area is usual, or if fewer than
        five are known.
    """
    off = np.zeros(len(areas))
    known = np.flatnonzero(np.isfinite(areas))
    if len(known) < _FEWEST:
        return off
    logs = np.log(areas[known])
    middle = float(np.median(logs))
    away = np.abs(logs - middle)
    unusual = away > _UNUSUAL * (_SCATTER + 1.4826 * float(np.median(away)))
    radii = np.sqrt(areas[known[unusual]] / np.pi) + np.sqrt(np.exp(middle) / np.pi)
    off[known[unusual]] = (1 - np.exp(-away[unusual])) * radii / np.sqrt(2)
    return off
