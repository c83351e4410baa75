"""The outline of a ball in all images together, near an outline that one picture shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration._errors import or_none
from calibration.radiance.stack import Images
from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.highlights.spots import reduced_image
from calibration.spheres.outline.facing_edges import EdgesAround
from calibration.spheres.outline.joint_edge import (
    JointOutline,
    bright_support,
    joint_outline,
    part_covariance,
)
from calibration.spheres.outline.limb import LARGEST_BLUR_PX
from calibration.spheres.outline.outline import SHARP_PX, image_noise
from calibration.spheres.outline.outline_noise import scatter_covariance
from rig.arrays import Float32, Float64

_MARGIN_SHARE, _MARGIN_PX = 0.3, 24
_MOST_IMAGES = 18
# An outline that edges support this well has no rival. Noise supports up to 0.25 of large outlines.
WITHOUT_DOUBT, _LEAST_SUPPORT = 0.65, 0.3
_LEADERS, _QUICK_ANGLES = 6, 360
_SAME_PX, _NEAR_PX = 0.25, 1.0
# Edges that are more blurred than the model of the limb are seen in smaller images. The same
# distances from an outline are fewer pixels there, so more edges must agree, by this share.
FACTORS, _SMALLEST_PX, _MORE_SUPPORT = (1, 2, 3, 4, 6, 8, 12, 16), 25.0, 0.2
# Edges along this length of an outline count as one observation.
_INDEPENDENT_PX = 16.0
# A ball mirrors circles inside itself, but none around itself: an outline that is larger by
# 5 % wins if it has nearly as much support. The inner one counts as two observations less.
_LARGER, _AS_GOOD, _INNER = 1.05, 0.1, 2.0
# Where edges do not support an outline, they are elsewhere, and so may be the outline: this many px
# over that share of its length. A blur hides so much of itself, and more for each px of it.
_ELSEWHERE_PX, _OF_BLUR, _MORE_BLUR = 1.0, 0.05, 0.01


@dataclass(frozen=True, eq=False)
class JointNear(JointOutline):
    """An outline from the edges of all images, with its covariance.

    Parameters
    ----------
    covariance_px2
        ``(3, 3)``, of centre x, centre y and radius, without systematic errors.
    bright_support
        Support where the surroundings are bright, see `joint_edge.bright_support`; NaN if they are
        hardly bright, and of an outline without doubt.
    factor
        How many times smaller the images are in which its edges are seen.
    """

    covariance_px2: Float64
    bright_support: float = float("nan")
    factor: int = 1

    @property
    def model_px(self) -> float:
        """Systematic error of centre x, centre y and radius: unsupported edges and the blur."""
        hidden = _OF_BLUR + _MORE_BLUR * self.blur_px
        return (1 - self.support) * _ELSEWHERE_PX + hidden * self.blur_px


def joint_near(
    values: Images, guess: Ellipse, reach_px: float, factors: Sequence[int] = FACTORS
) -> JointNear | None:
    """Return the outline near a guess that the edges of most images support, or None.

    Parameters and result are those of `OutlinesNear` and `OutlinesNear.within`.
    """
    return OutlinesNear(values, guess).within(reach_px, factors)


class OutlinesNear:
    """Outlines near a guess that the edges of most images support, within one reach or several.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    guess
        The approximate outline.
    """

    def __init__(self, values: Images, guess: Ellipse) -> None:
        self._values, self._guess = values, guess
        part = _cut(values, guess)
        self._sizes = {} if part is None else {1: _Sized(part[0], guess, 1, part[1])}

    def within(self, reach_px: float, factors: Sequence[int] = FACTORS) -> JointNear | None:
        """Return the outline that most edges support, or None.

        The guess is refined by `joint_outline`. If less than two thirds of its length are then
        supported, other circles within the reach are refined as well, and the one with the most
        support is the outline. The others add to its covariance as far as they are plausible: one
        that has n observations less (16 px of circumference each) has the weight exp(-n). If less
        than two thirds of a large outline are supported, its edges may be more blurred than the
        model of the limb; then smaller images are tried, down to a radius of 25 px. What they show
        counts only if it is that blurred.

        Parameters
        ----------
        reach_px
            Largest error of the guess in its centre and in its radius.
        factors
            How many times smaller the images are that are compared, one after the other. If the
            first ones are smaller and show sharp edges, the large images decide near these.
        """
        best: tuple[_Sized, list[JointOutline]] | None = None
        for factor in factors if self._sizes else ():
            doubtful = best is None or best[1][0].support <= WITHOUT_DOUBT
            if factor > 1 and not (doubtful and self._guess.radius_px >= factor * _SMALLEST_PX):
                break
            if factor not in self._sizes:
                self._sizes[factor] = self._sizes[1].smaller(factor, self._guess)
            sized = self._sizes[factor]
            found = sized.found(reach_px / factor)
            if not found:
                continue
            blurred = factor == 1 or found[0].blur_px * factor > LARGEST_BLUR_PX
            if not blurred and factor == factors[0]:
                return joint_near(self._values, sized.outline(found[0]), _NEAR_PX * factor)
            if blurred and (best is None or found[0].support > best[1][0].support + _MORE_SUPPORT):
                best = sized, found
        return None if best is None else best[0].with_covariance(best[1])


class _Sized:
    """Images of one size, and the outlines in them near a guess, which are found once.

    The images are smaller by ``factor``, and begin at the pixel ``start``.
    """

    def __init__(self, images: Images, guess: Ellipse, factor: int, low: Float64) -> None:
        # The centre of the first pixel of a smaller image is between the first pixels.
        self.start: Float64 = low + np.float64((factor - 1) / 2)
        self.images, self.factor, self._low = images, factor, low
        self.guess = guess.scaled(1, -self.start).scaled(1 / factor, np.zeros(2))
        self._refined: dict[tuple[Ellipse, bool], JointOutline | None] = {}

    def smaller(self, factor: int, guess: Ellipse) -> _Sized:
        """Return the images at a lower resolution."""
        size = self.images.shape[2] // factor, self.images.shape[1] // factor
        every = range(len(self.images))
        images = np.stack([reduced_image(self.images[k], size, factor) for k in every])
        return _Sized(images, guess, factor, self._low)

    def outline(self, joint: JointOutline) -> Ellipse:
        """Return an outline in these images in pixels of the large ones."""
        return joint.outline.scaled(self.factor, self.start)

    @cached_property
    def _lifted(self) -> list[Float32]:
        return [_lifted(self.images[k]) for k in range(len(self.images))]

    def found(self, reach_px: float) -> list[JointOutline]:
        """Return the outlines near the guess, the best one first; none if that is doubtful."""
        found = self._searched(reach_px)
        if not found:
            return []
        found.sort(key=lambda one: -one.support)
        best = self._refine(found[0].outline, quick=False)
        if best is None or best.support < _LEAST_SUPPORT:
            return []
        return [] if best.rms_px >= SHARP_PX else [best, *found[1:]]

    def _searched(self, reach_px: float) -> list[JointOutline]:
        """Return the outlines near the guess, from fewer angles."""
        circle = Ellipse.circle(*self.guess.circle_px)
        found: list[JointOutline] = []

        def refine(trial: Ellipse) -> None:
            joint = self._refine(trial, quick=True)
            if joint and np.abs(circle.change_to(joint.outline)).max() <= 1.2 * reach_px:
                found.append(joint)

        refine(self.guess)
        if found and found[0].support > WITHOUT_DOUBT:
            return found
        leaders = EdgesAround(self._lifted, circle, reach_px).leaders()
        for trial in [circle, *leaders[:_LEADERS]]:
            if all(np.abs(one.outline.change_to(trial)).max() > _NEAR_PX for one in found):
                refine(trial)
        return found

    def _refine(self, trial: Ellipse, *, quick: bool) -> JointOutline | None:
        """Return the outline next to another one, from few angles or all; None if none is seen."""
        if (trial, quick) not in self._refined:
            few = (2, _QUICK_ANGLES) if quick else ()
            self._refined[trial, quick] = or_none(joint_outline, self.images, trial, *few)
        return self._refined[trial, quick]

    def with_covariance(self, found: list[JointOutline]) -> JointNear:
        """Return the best outline of some in pixels of the large images."""
        joint = found[0]
        covariance = _covariance(found) + part_covariance(self.images, joint.outline)
        doubted = joint.support <= WITHOUT_DOUBT
        bright = bright_support(self.images, joint.outline) if doubted else float("nan")
        return JointNear(
            self.outline(joint),
            joint.points_px * self.factor + self.start,
            joint.coverage,
            joint.support,
            joint.blur_px * self.factor,
            covariance * self.factor**2,
            bright,
            self.factor,
        )


def best_of(found: Sequence[JointNear]) -> JointNear | None:
    """Return the best of several outlines; its covariance contains the others that may be right.

    As in `joint_near`, one that has n observations less has the weight exp(-n).

    Parameters
    ----------
    found
        Results of `joint_near`; the result for an empty list is None.
    """
    if not found:
        return None
    best = max(found, key=lambda one: one.support)
    larger = [
        one
        for one in found
        if one.support > best.support - _AS_GOOD
        and one.outline.radius_px > _LARGER * best.outline.radius_px
    ]
    best = max(larger or [best], key=lambda one: one.support)
    length = 2 * np.pi * best.outline.radius_px / _INDEPENDENT_PX
    others = [one for one in found if one is not best]
    changes = [best.outline.change_to(one.outline) for one in others]
    inner = [_LARGER * one.outline.radius_px < best.outline.radius_px for one in others]
    less = [length * (best.support - one.support) for one in others]
    weights = np.exp([-n - _INNER * of_inner for n, of_inner in zip(less, inner, strict=True)])
    covariance = best.covariance_px2
    for weight, change in zip(weights / (1 + weights.sum()), changes, strict=True):
        covariance = covariance + weight * np.outer(change, change)
    return replace(best, covariance_px2=covariance)


def edges_agree(values: Images, outline: Ellipse) -> bool:
    """Return whether the edges of all images confirm an outline, without doubt and to 0.25 px.

    Parameters are those of `joint_near`, which takes several times as long.
    """
    support, change = _at(values, outline)
    return support > WITHOUT_DOUBT and bool(np.abs(change).max() < _SAME_PX)


def edges_support(values: Images, outline: Ellipse) -> bool:
    """Return whether the edges of all images support an outline, to a pixel, more than noise."""
    return _at(values, outline)[0] >= _LEAST_SUPPORT


def _at(values: Images, outline: Ellipse) -> tuple[float, Float64]:
    """Return the support of an outline by the edges next to it, and the change to theirs."""
    part = _cut(values, outline)
    if part is None:
        return 0.0, np.zeros(3)
    crop, low = part
    guess = outline.scaled(1, -low)
    joint = or_none(joint_outline, crop, guess, 1, _QUICK_ANGLES)
    return (joint.support, guess.change_to(joint.outline)) if joint else (0.0, np.zeros(3))


def _cut(values: Images, around: Ellipse) -> tuple[Images, Float64] | None:
    """Return a part of at most 18 images around an outline, 1 where NaN, and where it starts."""
    far = around.radius_px + _MARGIN_SHARE * around.radius_px + _MARGIN_PX
    centre = np.array(around.centre_px)
    low = np.maximum((centre - far).astype(int), 0)
    high = np.minimum((centre + far).astype(int) + 2, values.shape[:0:-1])
    if np.any(high - low < _MARGIN_PX):
        return None
    every = -(-len(values) // _MOST_IMAGES)
    part = values[::every, low[1] : high[1], low[0] : high[0]]
    return np.where(np.isnan(part), np.float32(1), part), low.astype(np.float64)


def _covariance(found: list[JointOutline]) -> Float64:
    """Return the covariance of the best of some outlines, which are sorted by support."""
    best = found[0]
    length = 2 * np.pi * best.outline.radius_px / _INDEPENDENT_PX
    changes = [best.outline.change_to(one.outline) for one in found]
    less = [length * (one.support - best.support) for one in found]
    return with_others(scatter_covariance(best), changes, less)


def with_others(covariance: Float64, changes: Sequence[Float64], less: Sequence[float]) -> Float64:
    """Return a covariance that contains the others of several outlines, the best one first.

    Parameters
    ----------
    covariance
        ``(3, 3)``, of centre x, centre y and radius of the best outline.
    changes
        Changes from the best outline to each, that of the best one among them.
    less
        Logarithms of how plausible they are, relative to the best one.
    """
    others: list[tuple[float, Float64]] = []
    for change, log in zip(changes, less, strict=True):
        if all(np.abs(change - other).max() > _SAME_PX for _, other in others):
            others.append((float(np.exp(log)), change))
    total = sum(weight for weight, _ in others)
    for weight, change in others:
        covariance = covariance + weight / total * np.outer(change, change)
    return covariance


def _lifted(image: Float32) -> Float32:
    """Return an image to which a multiple of its noise is added, for its logarithm."""
    noise = image_noise(image)
    offset = max(10 * noise, 0.002 * float(image.mean()), 1e-4)
    return np.maximum(image, 0) + np.float32(offset)
