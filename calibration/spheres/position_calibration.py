"""Light positions from two or more spheres in one refinement, and tests of the given values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from acquisition import CameraModel, LightErrors, Lights, angle_deg
from calibration.spheres.geometry.cone import Cone
from calibration.spheres.highlights.highlights import Highlights
from calibration.spheres.judge.input_tests import check_inputs, doubts
from calibration.spheres.outline.sphere_image import places
from calibration.spheres.solve.joint_refinement import (
    KnownSpheres,
    Observation,
    predicted_highlights,
)
from calibration.spheres.solve.light_positions import (
    LocatedLights,
    locate_lights,
    observed_rays,
    pair_positions,
)
from calibration.spheres.solve.lost_images import named
from calibration.spheres.solve.sphere_calibration import SeenTogether, SphereCalibration, rms_deg
from calibration.spheres.solve.sphere_positions import place
from rig import Notice
from rig.arrays import Bool, Float64

_POOR_RESIDUAL_DEG = 0.2
# The refinement moves wrong spheres until they nearly agree, so a remaining error of half a degree
# means an error of many degrees of the lights.
_UNTRUSTED_DEG = 0.5
_LEAST_AGREEING = 0.5
# A mean error that should not occur without a warning. Independent errors of many lights have a
# mean close to their standard deviation; those that all lights share exceed 1.96 of theirs in 5 %.
_UNCERTAIN_MM, _SHARED_SIGMAS = 2.0, 1.96
# Residuals of one light that are much larger than those of the others.
_DOUBTFUL_PX, _DOUBTFUL_RATIO = 1.0, 5.0
# Outlines are not refined yet: spheres agree to this, or to what lights without rivals show.
_AGREES_PX = 0.5
_WIDER = 2.0
# Cost of a sphere whose candidates all disagree, that of an error of four standard deviations.
_UNEXPLAINED = 8.0
# A second choice with less additional cost leaves the light undecided.
_DECIDED = 3.0
_EXAMPLES = 12


def positioned_lights(
    shown: SeenTogether,
    cones: list[Cone],
    radii: Float64,
    camera: CameraModel,
    warnings: list[Notice],
) -> SphereCalibration:
    """Estimate positions; leave out a sphere that was searched for and contradicts the others."""
    names, images = shown.lights, shown.images
    placed = place(cones, radii, camera)
    chosen, apart_mm2 = choose_highlights(camera, placed, [image.highlights for image in images])
    highlights = np.stack([one.pixels for one in chosen], axis=1)
    sigma_px = np.stack([one.sigma_px for one in chosen], axis=1)
    peaks = not any(one.saturated.any() for one in chosen)
    photons = [one.photon_px2 for one in chosen if one.photon_px2 is not None]
    photon_px2 = np.stack(photons, axis=1) if len(photons) == len(chosen) else None
    given = Observation(camera, placed, highlights, sigma_px)
    located = locate_lights(given, names, peaks=peaks, photon_px2=photon_px2)
    positions, centres = located.refined.positions_mm, located.refined.centres_mm
    used = located.used
    seen = np.isfinite(highlights[..., 0])
    share = used.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    worst = int(np.argmin(np.where(shown.found, share, np.inf)))
    # With only two spheres it is unknown which one is wrong; the residuals show the contradiction.
    if shown.found[worst] and len(images) > 2 and share[worst] < _LEAST_AGREEING:
        text = (
            f"{places([images[worst]])} was left out: only {used[:, worst].sum()} of its "
            f"{seen[:, worst].sum()} highlights agree with the other spheres"
        )
        recording = shown.names[shown.of_recording[worst]]
        warnings.append(Notice("sphere-contradicts", text, recording))
        cones = [cone for k, cone in enumerate(cones) if k != worst]
        radii = np.delete(radii, worst)
        return positioned_lights(shown.without(worst), cones, radii, camera, warnings)
    points, rays = observed_rays(camera, replace(placed, centres_mm=centres), highlights)
    residuals = rms_deg(angle_deg(positions[:, None] - points, rays), used)
    disagreement = float(np.median(residuals))
    if disagreement > _UNTRUSTED_DEG:
        text = (
            f"the spheres contradict each other by {disagreement:.1f} degrees: do not trust these "
            "lights; check outlines, radii and camera"
        )
        warnings.append(Notice("lights-untrusted", text))
    elif disagreement > _POOR_RESIDUAL_DEG:
        text = (
            f"the spheres agree about the lights only to {disagreement:.1f} degrees: "
            "check outlines, radii and camera"
        )
        warnings.append(Notice("spheres-disagree", text))
    others_mm: list[Float64] = []
    if disagreement <= _UNTRUSTED_DEG:
        outlines = [image.points_px for image in images]
        weighed = replace(given, sigma_px=located.sigma_px)
        tests = check_inputs(weighed, outlines, located.refined)
        doubted, others_mm = doubts(tests, camera, radii, shown.places_mm)
        warnings = _with_doubts(warnings, doubted)
    doubtful = _doubtful(located)
    warnings += _doubts_about_lights(names, located, doubtful, np.trace(apart_mm2.T) > 0)
    dropped = int(np.sum(seen & ~used))
    if dropped:
        text = f"{dropped} highlights disagree with the other spheres and were left out"
        warnings.append(Notice("highlights-left-out", text))
    total_mm2 = np.trace(located.refined.covariance_mm2, axis1=1, axis2=2).mean()
    independent_mm2 = np.trace(located.refined.independent_mm2, axis1=1, axis2=2).mean()
    shared_mm2 = max(total_mm2 - independent_mm2, 0.0)
    sigma_mm = float(np.sqrt(total_mm2))
    if np.sqrt(independent_mm2 + _SHARED_SIGMAS**2 * shared_mm2) > _UNCERTAIN_MM:
        text = (
            f"the positions of the lights are uncertain by {sigma_mm:.1f} mm (standard deviation): "
            "use larger spheres, more of them, farther apart, or a camera with more pixels"
        )
        warnings.append(Notice("lights-uncertain", text))
    covariances = _widened(located, doubtful) + apart_mm2
    for other_mm in others_mm:  # the lights of values that explain the images better
        off = other_mm - positions
        covariances += off[:, :, None] * off[:, None]
    errors = LightErrors(covariances, residual_px=located.residuals_px, spheres=used.sum(axis=1))
    lights = Lights(positions_mm=positions, ids=names, errors=errors)
    spheres = shown.spheres(replace(placed, centres_mm=centres))
    return SphereCalibration(lights, spheres, highlights, used, residuals, tuple(warnings))


def _doubtful(located: LocatedLights) -> Bool:
    """Return the lights whose spheres disagree by far more than those of the others."""
    residuals = located.residuals_px
    limit = max(_DOUBTFUL_PX, _DOUBTFUL_RATIO * float(np.median(residuals)))
    return np.asarray(residuals > limit, np.bool_)


def _widened(located: LocatedLights, doubtful: Bool) -> Float64:
    """Return the covariances; those of doubtful lights grow to what their residuals show."""
    sigma_px = np.where(located.used, located.sigma_px, np.nan)
    stated = np.sqrt(np.nanmean(sigma_px[doubtful] ** 2, axis=1))
    covariance = located.refined.covariance_mm2.copy()
    growth = np.maximum(located.residuals_px[doubtful] / stated, 1) ** 2
    covariance[doubtful] *= growth[:, None, None]
    return covariance


def _doubts_about_lights(
    names: tuple[str, ...], located: LocatedLights, doubtful: Bool, undecided: Bool
) -> Iterator[Notice]:
    """Yield notices about lights with several possible highlights, or whose spheres disagree."""
    if undecided.any():
        text = (
            f"{named(names, np.flatnonzero(undecided), 8)}: several bright spots are possible "
            "highlights, and agree between the spheres; the brighter ones were used, and the "
            "stated errors contain the others: cover lamps and windows, or use more spheres"
        )
        yield Notice("highlights-undecided", text)
    if doubtful.any():
        residuals = located.residuals_px
        text = (
            f"{named(names, np.flatnonzero(doubtful), 8)}: the highlights on the spheres disagree "
            f"by up to {residuals.max():.1f} px, those of the other lights by "
            f"{np.median(residuals):.2f} px: at least one of the spots is not the "
            "reflection of the light; do not trust its position"
        )
        yield Notice("light-doubtful", text)


def _with_doubts(warnings: list[Notice], doubts: list[Notice]) -> list[Notice]:
    """Add doubts about the given values; a warning that spheres are off the plane takes them up."""
    off = [k for k, warning in enumerate(warnings) if warning.code == "spheres-off-the-plane"]
    if not (off and doubts):
        return warnings + doubts
    text = "; ".join(notice.text for notice in (warnings[off[0]], *doubts))
    return [replace(one, text=text) if k == off[0] else one for k, one in enumerate(warnings)]


def choose_highlights(
    camera: CameraModel, spheres: KnownSpheres, highlights: Sequence[Highlights]
) -> tuple[list[Highlights], Float64]:
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
    apart_mm2
        ``(N, 3, 3)`` covariance of each position by other candidates that agree nearly as well; 0
        if the choice is decided.
    """
    pixels = np.stack([one.candidates.pixels for one in highlights], axis=1)
    sigma_px = np.stack([one.candidates.sigma_px for one in highlights], axis=1)
    share = np.stack([one.candidates.share for one in highlights], axis=1)
    several = np.isfinite(pixels[..., 0]).sum(axis=2).max(axis=1, initial=0) > 1
    apart_mm2 = np.zeros((len(pixels), 3, 3))
    picks = np.where(np.stack([one.found for one in highlights], axis=1), 0, -1)
    if not several.any() or len(highlights) < 2:
        return list(highlights), apart_mm2
    plain = np.flatnonzero(~several)
    plain = plain[:: max(len(plain) // _EXAMPLES, 1)]
    usual = [_errors(camera, spheres, pixels[i])[1][..., 0] for i in plain]
    typical = [float(np.nanmedian(e, axis=1).min()) for e in usual if len(e)]
    agrees_px = max(_AGREES_PX, _WIDER * float(np.median(typical or [0.0])))
    for i in np.flatnonzero(several):
        positions, errors = _errors(camera, spheres, pixels[i])
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
        second = int(np.argmin(np.where(others, total, np.inf)))
        if others[second] and total[second] < total[best] + _DECIDED:
            apart = positions[second] - positions[best]
            apart_mm2[i] = np.outer(apart, apart) / (1 + np.exp(total[second] - total[best]))
    return [one.chosen(picks[:, k]) for k, one in enumerate(highlights)], apart_mm2


def _errors(camera: CameraModel, spheres: KnownSpheres, pixels: Float64) -> tuple[Float64, Float64]:
    """Return P proposed positions, and distances of candidates ``(K, M, 2)`` from what they show.

    The distances ``(P, K, M)`` are NaN where there is no candidate.
    """
    points, directions = observed_rays(camera, spheres, pixels.swapaxes(0, 1))
    seen = np.isfinite(directions[..., 0])
    proposals = []
    for a, b in combinations(range(len(pixels)), 2):
        for m, n in product(np.flatnonzero(seen[:, a]), np.flatnonzero(seen[:, b])):
            pair = [m, n], [a, b]
            proposals.append(pair_positions(points[pair], directions[pair]))
    positions = np.concatenate(proposals) if proposals else np.zeros((0, 3))
    predicted = predicted_highlights(camera, spheres.centres_mm, spheres.radii_mm, positions)
    return positions, np.linalg.norm(predicted[:, :, None] - pixels, axis=-1)
