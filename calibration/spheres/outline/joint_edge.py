"""The edge of a ball in all images together, each of which may be wrong about a part of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calibration._errors import EstimateError
from calibration.radiance.stack import Images
from calibration.spheres.geometry.ellipse import ELLIPSE_COVERAGE, Ellipse, fit_ellipse
from calibration.spheres.outline.limb import (
    REACH_PX,
    SHIFT_STEP_PX,
    Profiles,
    edge_costs,
    estimate_blur,
    interpolated_shifts,
    profile_offsets,
    smooth_along,
    stack_profiles,
)
from calibration.spheres.outline.outline import ALONG_PX, TracedOutline, edge_angles, image_noise
from rig.arrays import Bool, Float64

# Share of a profile's contrast that the model of the limb does not explain, and the most evidence
# (misfit in variances) that one image, and all images, give against an edge at one angle.
_MODEL, _MOST_OF_IMAGE, _MOST_OF_ANGLE = 0.03, 16.0, 25.0
# An edge is seen at an angle if it explains the images by this much better than another place.
_LEAST_EVIDENCE = 10.0
_STRONG_PERCENT, _MOST_OF_STRONG = 70, 3
# The trial circles of the search: steps in pixels, and at how many angles they are compared.
_SEARCH = np.arange(-5, 6) * 0.2
_COMPARED = 240
# Edges farther than this from the circle do not count, in rounds.
_WINDOWS_PX = (1.0, 0.8, 0.4, 0.4, 0.4, 0.4)
_FEWEST, _MOST_ANGLES = 12, 2000
_SAME_EDGES_PX = 0.5
_PARTS = 4
# The surroundings are what is seen at these multiples of the radius, under the brighter lights.
_RINGS, _BRIGHTER_PERCENT = (1.1, 1.2, 1.3), 90
# They are black below so many standard deviations of the noise, and below this share of white.
_BLACK_SIGMAS, _BLACK = 10.0, 0.01
_LEAST_SHARE = 0.2


@dataclass(frozen=True, eq=False)
class JointOutline(TracedOutline):
    """An outline from the edges of all images.

    Parameters
    ----------
    support
        Share 0..1 of the circumference where an edge agrees with the outline, by its distance.
    blur_px
        Blur of the edges: the trial value that fits the images best, see `estimate_blur`.
    """

    support: float
    blur_px: float


def joint_outline(
    values: Images, guess: Ellipse, rounds: int = 2, most_angles: int = _MOST_ANGLES
) -> JointOutline:
    """Fit the outline of a ball to the edges in all images.

    What a ball mirrors, shadows and objects behind it put other edges near its outline. They move
    or vanish with the light; the outline stays. In each image and at each angle, the model of a
    blurred limb is compared at each trial place of the edge; the misfit is bounded, so that an
    image can only abstain. The sum over the images is bounded as well, so that an angle can only
    abstain. The circle of the least sum over the angles is refined with the edges close to it.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, not NaN.
    guess
        The outline, to a pixel.
    rounds
        How often edges are searched for around the last outline.
    most_angles
        At how many angles, one per pixel of a smaller outline.

    Raises
    ------
    EstimateError
        If fewer than 12 edge points agree with an outline near the guess.
    """
    outline, blur_px = guess, None
    for _ in range(rounds):
        edges = _Edges(values, outline, most_angles, blur_px)
        fit = edges.fit(edges.every_image, edges.every_angle)
        outline = outline.moved(fit.change)
        # Nearly the same edges have the same blur.
        blur_px = edges.blur_px if np.abs(fit.change).max() < _SAME_EDGES_PX else None
    near = fit.weights > 0
    angles, offsets = edges.angles[near], fit.offsets[near]
    points = edges.around.point(angles, 1 + offsets / edges.around.radius_px)
    coverage = float(near.mean())
    if coverage > ELLIPSE_COVERAGE:
        outline, weights = fit_ellipse(points, outline)
        points = points[weights > 0]
        coverage *= float(np.mean(weights > 0))
    support = float(fit.weights.mean())
    return JointOutline(outline, points, coverage, support, edges.blur_px)


def part_covariance(values: Images, outline: Ellipse) -> Float64:
    """Return the covariance by which outlines of parts of the data differ from each other.

    The parts are halves of the images, which differ by twice the deviation of one, and all but one
    quarter of the circumference (jackknife). A part that determines nothing counts as a pixel.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, not NaN.
    outline
        The outline of all, from `joint_outline`.

    Returns
    -------
    Array
        ``(3, 3)``, of centre x, centre y and radius.
    """
    edges = _Edges(values, outline)
    whole = edges.part(edges.every_image, edges.every_angle)
    total = np.zeros((3, 3))
    halves = _halvings(len(values))
    for half in halves:
        apart = edges.part(half, edges.every_angle) - edges.part(~half, edges.every_angle)
        total += np.outer(apart, apart) / (4 * len(halves))
    turns = np.floor(edges.angles / (2 * np.pi) * 2 * _PARTS).astype(int)
    for first in (0, 1):
        quarter = (turns + first) // 2 % _PARTS
        parts = [edges.part(edges.every_image, quarter != part) for part in range(_PARTS)]
        deviations = np.array(parts) - whole
        total += (1 - 1 / _PARTS) * deviations.T @ deviations / 2
    return total


def edge_agreement(values: Images, outline: Ellipse) -> tuple[Float64, Float64]:
    """Return angles around an outline, and how well an edge agrees with it at each.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, not NaN.
    outline
        The outline of all, from `joint_outline`.

    Returns
    -------
    angles, agreement
        ``(M,)`` each; the agreement is 0 without an edge, 1 for one on the outline. Its mean is the
        support.
    """
    edges = _Edges(values, outline)
    try:
        return edges.angles, edges.fit(edges.every_image, edges.every_angle).weights
    except EstimateError:
        return edges.angles, np.zeros(len(edges.angles))


@dataclass(frozen=True, eq=False)
class _Fit:
    """A circle near the approximate outline: its change, and edges and weights of all angles."""

    change: Float64
    offsets: Float64
    weights: Float64


class _Edges:
    """How well each image agrees with an edge at each angle and place near an outline."""

    def __init__(
        self,
        values: Images,
        around: Ellipse,
        most_angles: int = _MOST_ANGLES,
        blur_px: float | None = None,
    ) -> None:
        self.around = around
        self.angles = edge_angles(around, most_angles)
        self.every_image = np.ones(len(values), bool)
        self.every_angle = np.ones(len(self.angles), bool)
        images = [values[k] for k in range(len(values))]
        profiles = stack_profiles(images, around, self.angles, profile_offsets())
        profiles = smooth_along(profiles, ALONG_PX)
        samples, shape = len(profiles), profiles.shape[1:]
        flat = profiles.reshape(samples, -1)
        power = flat.var(axis=0)
        if blur_px is None:
            strong = np.flatnonzero(power >= np.percentile(power, _STRONG_PERCENT))
            blur_px = estimate_blur(flat[:, strong[::_MOST_OF_STRONG]])
        self.blur_px = blur_px
        misfit = edge_costs(flat, self.blur_px).reshape(-1, *shape)
        least = misfit.min(axis=0)
        free = samples - 5
        variance = np.median(least, axis=1, keepdims=True) / free
        variance = variance + _MODEL**2 * power.reshape(shape) + 1e-12
        variance = np.maximum(variance, least / free)
        misfit -= least
        misfit /= variance
        misfit /= 1 + misfit / _MOST_OF_IMAGE
        self._misfit = misfit
        x, y = around.point(self.angles).T
        height, width = values.shape[1:]
        self._inside = (np.minimum(x, y) > REACH_PX) & (x < width - 1 - REACH_PX)
        self._inside &= y < height - 1 - REACH_PX

    def fit(self, images: Bool, angles: Bool) -> _Fit:
        """Fit a circle to some images and angles."""
        misfit = self._misfit if images.all() else self._misfit[:, images]
        evidence = misfit.sum(axis=1)
        evidence -= evidence.min(axis=0)
        offsets, seen = _best_shifts(evidence)
        seen &= angles & self._inside
        if np.count_nonzero(seen) < _FEWEST:
            raise _too_few(self.around)
        change = self._searched(evidence, angles & self._inside)
        design = np.column_stack(
            [np.cos(self.angles), np.sin(self.angles), np.ones(len(self.angles))]
        )
        for window in _WINDOWS_PX:
            distance = (offsets - design @ change) / window
            weights = np.where(seen, np.clip(1 - distance**2, 0, None) ** 2, 0.0)
            if np.count_nonzero(weights) < _FEWEST:
                raise _too_few(self.around)
            weighted = design * weights[:, None]
            change = np.linalg.lstsq(weighted.T @ design, weighted.T @ offsets, rcond=None)[0]
        return _Fit(change, offsets, weights)

    def _searched(self, evidence: Profiles, use: Bool) -> Float64:
        """Return the change of centre and radius with the least bounded misfit, on a grid."""
        some = np.flatnonzero(use)[:: max(len(use) // _COMPARED, 1)]
        angles = self.angles[some]
        x, y = (v.reshape(-1, 1) for v in np.meshgrid(_SEARCH, _SEARCH))
        # Places beyond the last shift count as misfits.
        farthest = 3 * _SEARCH[-1] / SHIFT_STEP_PX
        beyond = int(farthest) + 1 - len(evidence) // 2
        bounded = np.minimum(evidence[:, some], _MOST_OF_ANGLE)
        bounded = np.pad(bounded, ((beyond, beyond), (0, 0)), constant_values=_MOST_OF_ANGLE)
        edge = np.rint((x * np.cos(angles) + y * np.sin(angles)) / SHIFT_STEP_PX).astype(int)
        place = (edge + len(bounded) // 2) * len(some) + np.arange(len(some))
        steps = np.rint(_SEARCH / SHIFT_STEP_PX).astype(int) * len(some)
        misfits = np.array([bounded.take(place + step, mode="clip").sum(axis=1) for step in steps])
        radius, centre = np.unravel_index(np.argmin(misfits), misfits.shape)
        return np.array([x[centre, 0], y[centre, 0], _SEARCH[radius]])

    def part(self, images: Bool, angles: Bool) -> Float64:
        """Return the change of centre and radius of a part of the data, a pixel if it has none."""
        try:
            return self.fit(images, angles).change
        except EstimateError:
            return np.ones(3)


def _halvings(count: int) -> list[Bool]:
    """Return which of some images are in one half, in several ways."""
    index = np.arange(count)
    return [(index >> bit) % 2 == 0 for bit in range(3) if count > 1 << bit]


def _best_shifts(evidence: Profiles) -> tuple[Float64, Bool]:
    """Return the best place of the edge at each angle, and where an edge is seen."""
    best = np.argmin(evidence, axis=0)
    inner = (best > 0) & (best < len(evidence) - 1)
    seen = inner & (np.minimum(evidence[0], evidence[-1]) > _LEAST_EVIDENCE)
    return interpolated_shifts(evidence, best), seen


def _too_few(around: Ellipse) -> EstimateError:
    x, y = around.centre_px
    return EstimateError(f"no edge agrees with an outline at ({x:.0f}, {y:.0f}) px")


def bright_support(images: Images, outline: Ellipse) -> float:
    """Return the support of an outline where its surroundings are bright.

    A ball on a black cloth mirrors the border of the cloth as a sharp circle inside its outline,
    and looks like the cloth outside of this circle. Where the surroundings are bright, they are
    brighter than their mirror image, so that the outline is seen there, and the circle is not.

    Parameters
    ----------
    images
        ``(N, H, W)`` linear images, 1 is white, not NaN.
    outline
        An outline from `joint_outline`.

    Returns
    -------
    float
        Share 0..1 of the bright part of the circumference where an edge agrees with the outline, by
        its distance; NaN if less than a fifth of the circumference is bright.
    """
    angles, agreement = edge_agreement(images, outline)
    around = np.stack([outline.point(angles, ring) for ring in _RINGS]).astype(np.float32)
    x, y = np.ascontiguousarray(around[..., 0]), np.ascontiguousarray(around[..., 1])
    height, width = images.shape[1:]
    inside = np.all((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1), axis=0)
    each = [images[k] for k in range(len(images))]
    seen = [cv2.remap(image, x, y, cv2.INTER_LINEAR) for image in each]
    level = np.median(np.percentile(seen, _BRIGHTER_PERCENT, axis=0), axis=0)
    noise = float(np.median([image_noise(image) for image in each]))
    bright = inside & (level > max(_BLACK_SIGMAS * noise, _BLACK))
    if bright.mean() < _LEAST_SHARE:
        return float("nan")
    return float(agreement[bright].mean())
