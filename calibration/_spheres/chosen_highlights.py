"""Choice among several possible highlights of a light: those that agree on all spheres."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from calibration._spheres.highlights import Highlights
from calibration._spheres.joint_refinement import KnownSpheres, predicted_highlights
from calibration._spheres.ray_positions import observed_rays, pair_positions
from calibration._spheres.robust import Array

# Outlines are not refined yet: spheres agree to this, or to what lights without rivals show.
_AGREES_PX = 0.5
_WIDER = 2.0
# Cost of a sphere whose candidates all disagree, that of an error of four standard deviations.
_UNEXPLAINED = 8.0
# A second choice with less additional cost leaves the light undecided.
_DECIDED = 3.0
_EXAMPLES = 12


def choose_highlights(
    camera: CameraModel, spheres: KnownSpheres, highlights: Sequence[Highlights]
) -> tuple[list[Highlights], npt.NDArray[np.bool_]]:
    """Choose the candidates of each light that are highlights of one position.

    Every pair of candidates on two spheres proposes a position. It predicts the highlights on all
    spheres, and costs half of the squared distance to the nearest candidate in standard deviations,
    minus the logarithm of its share of the flux. Lights with one candidate on each sphere keep it.

    Parameters
    ----------
    camera
        Camera with a working distance.
    spheres
        K spheres.
    highlights
        The highlights of N lights on each of them.

    Returns
    -------
    highlights
        The highlights that agree; none where all candidates of a sphere disagree.
    undecided
        ``(N,)`` whether other candidates agree nearly as well.
    """
    pixels = np.stack([one.candidates.pixels for one in highlights], axis=1)
    sigma_px = np.stack([one.candidates.sigma_px for one in highlights], axis=1)
    share = np.stack([one.candidates.share for one in highlights], axis=1)
    several = np.isfinite(pixels[..., 0]).sum(axis=2).max(axis=1, initial=0) > 1
    undecided = np.zeros(len(pixels), bool)
    picks = np.where(np.stack([one.found for one in highlights], axis=1), 0, -1)
    if not several.any() or len(highlights) < 2:
        return list(highlights), undecided
    plain = np.flatnonzero(~several)
    plain = plain[:: max(len(plain) // _EXAMPLES, 1)]
    usual = [_errors(camera, spheres, pixels[i])[..., 0] for i in plain]
    typical = [float(np.nanmedian(e, axis=1).min()) for e in usual if len(e)]
    agrees_px = max(_AGREES_PX, _WIDER * float(np.median(typical or [0.0])))
    for i in np.flatnonzero(several):
        errors = _errors(camera, spheres, pixels[i])
        if not len(errors):
            continue
        variance = agrees_px**2 + sigma_px[i] ** 2
        cost = 0.5 * errors**2 / variance - np.log(np.maximum(share[i], 1e-9))
        cost = np.where(np.isfinite(cost), cost, np.inf)
        nearest = np.argmin(cost, axis=2)
        least = np.min(cost, axis=2)
        chosen = np.where(least < _UNEXPLAINED, nearest, -1)
        total = np.minimum(least, _UNEXPLAINED).sum(axis=1)
        best = int(np.argmin(total))
        picks[i] = chosen[best]
        both = (chosen >= 0) & (chosen[best] >= 0)
        others = np.any(both & (chosen != chosen[best]), axis=1)
        undecided[i] = bool(np.any(total[others] < total[best] + _DECIDED))
    return [one.chosen(picks[:, k]) for k, one in enumerate(highlights)], undecided


def _errors(camera: CameraModel, spheres: KnownSpheres, pixels: Array) -> Array:
    """Return the distances ``(P, K, M)`` of candidates ``(K, M, 2)`` from P predicted highlights.

    NaN where there is no candidate.
    """
    points, directions = observed_rays(camera, spheres, pixels.swapaxes(0, 1))
    seen = np.isfinite(directions[..., 0])
    proposals = []
    for a, b in combinations(range(len(pixels)), 2):
        for m, n in product(np.flatnonzero(seen[:, a]), np.flatnonzero(seen[:, b])):
            pair = (
                np.stack([points[m, a], points[n, b]]),
                np.stack([directions[m, a], directions[n, b]]),
            )
            proposals.append(pair_positions(*pair))
    positions = np.concatenate(proposals) if proposals else np.zeros((0, 3))
    predicted = predicted_highlights(camera, spheres.centres_mm, spheres.radii_mm, positions)
    errors: Array = np.linalg.norm(predicted[:, :, None] - pixels, axis=-1)
    return errors
