"""Images that the other images of a recording do not predict, and how they differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from acquisition import Lights
from calibration import EstimateError
from processing.checks.frame_faults import PredictedCells
from processing.checks.self_calibration import align, angles_deg, explained, robust_solution
from processing.checks.strength_fit import (
    StrengthFit,
    fit_strengths,
    light_vectors,
    project,
    solve_normals,
)
from processing.images.block_means import Cells
from rig import Notice, pluralize, short_repr
from rig.arrays import Bool, Float64

Kind = Literal["brightness", "moved", "swapped", "clipped", "striped", "shifted", "foreign"]
# The code of the notice, and what to do.
_CODES: dict[Kind, str] = {
    "swapped": "images-swapped",
    "moved": "light-moved",
    "brightness": "light-brightness",
    "clipped": "image-clipped",
    "striped": "image-striped",
    "shifted": "image-shifted",
    "foreign": "image-disagrees",
}
_REMEDIES: dict[Kind, str] = {
    "swapped": "check the order of images and lights",
    "moved": "did a lamp move, or is the image turned?",
    "brightness": "check intensities and exposure times",
    "clipped": "check the exposure and the white level",
    "striped": "record the image again",
    "shifted": "the object or the camera moved: record the image again",
    "foreign": "it may show another moment, other exposure, or stray light",
}

# Samples below this share of the brightest of their pixel may be in shadow.
_LIT = 0.15
_FEWEST_SAMPLES = 20
# Brightest share of an image, which is compared with the rest.
_TOP = 0.15
_BRIGHT = 0.9
_STEPS = 8
_MAD_TO_SIGMA = 1.4826
# Deviations from a matte surface are alike over large parts of an object: as many count as these.
_INDEPENDENT = 10.0
# Flatter objects, or those curved along one axis only, do not show where lights are.
_LEAST_RELIEF = 0.04
# Residuals, relative to the median, that have half of the weight.
_HALF_WEIGHT = 2.2
# Influence of a sample on its own prediction is at most this, or it would be divided by 0.
_LARGEST_LEVER = 0.95
_FEWEST_IMAGES = 6
_FEWEST_PIXELS = 100
_PIXELS = 1000
# Strengths that a flat object does not show stay near 1.
_PRIOR_SD = 0.1
# An image disagrees beyond a limit, this multiple of the typical deviation, and this many standard
# deviations.
_TYPICAL = 5.0
_SIGMAS = 4.0
_BRIGHTNESS = 0.07
_BRIGHTNESS_TYPICAL = 6.0
# Logarithms of half of the largest cost for the tilt.
_HALF_COST = 0.03
# If brightnesses scatter by more, no group of images agrees.
_SCATTER = 0.06
_MOVED_DEG = 6.0
_FOREIGN = 0.15
_FOREIGN_TYPICAL = 3.0
_CLIPPED = 0.03
_CLIPPED_TYPICAL = 3.0
# A plateau: samples above this share of the largest ones, the 99.5 % quantile, are this share of an
# image, and this multiple of the typical share.
_EQUAL = 0.98
_LARGEST = 0.995
_PLATEAU = 0.05
_PLATEAU_TYPICAL = 4.0
# Lights closer together than this, or this multiple of the typical deviation, count as one.
_SWAPPED_DEG = 4.0
_SWAPPED_TYPICAL = 4.0
_SWAPPED_SIGMAS = 2.0
# If a larger share and number disagree, it is not known which images are right.
_MOST = 0.3
_MOST_IMAGES = 2
_LISTED = 6
# This share of normally distributed values is within so many standard deviations.
_AGREEING = 0.45
_NORMAL_QUANTILE = 0.598


class _ImagePrediction(NamedTuple):
    """How each of N images differs from what the others predict.

    Parameters
    ----------
    vectors
        ``(N, 3)`` light vectors in the middle of the object that the images show, if the prediction
        has normals from the other images.
    sigma_deg
        ``(N,)`` standard deviations of the directions of these vectors; infinite if the object
        does not show them.
    left
        ``(N,)`` median relative deviation of each image, at its own brightness and light vector.
    top
        ``(N,)`` brightness of the brightest parts relative to the rest, 1 as predicted.
    """

    vectors: Float64
    sigma_deg: Float64
    left: Float64
    top: Float64


def _predict_images(fit: StrengthFit, middle: Float64) -> _ImagePrediction:
    """Predict each image from normals of the others.

    Parameters
    ----------
    fit
        Normals and strengths from all images.
    middle
        ``(N, 3)`` light vectors in the middle of the object.
    """
    vectors, samples = fit.vectors, fit.samples
    count = samples.shape[1]
    _, inverse = solve_normals(samples, fit.weights, vectors)
    predicted = project(vectors, fit.scaled_normals)
    level = np.quantile(np.maximum(predicted, 0), _BRIGHT, axis=1)
    length = np.linalg.norm(vectors, axis=2, keepdims=True)
    # Directions at a pixel differ from those in the middle by what is known.
    aside = vectors - length * middle / np.linalg.norm(middle, axis=1, keepdims=True)
    shown, sigma = np.array(middle), np.full(count, np.inf)
    left, top = np.zeros(count), np.ones(count)
    for i in range(count):
        one = vectors[:, i]
        # Normals without this image, by the formula of Sherman and Morrison.
        rows = (inverse @ np.broadcast_to(one, (len(samples), 3))[..., None])[..., 0]
        lever = np.clip(fit.weights[:, i] * np.sum(rows * one, axis=1), 0, _LARGEST_LEVER)
        share = fit.weights[:, i] * fit.residuals[:, i] / (1 - lever)
        normals = fit.scaled_normals - share[:, None] * rows
        expected = np.sum(normals * one, axis=1)
        seen = samples[:, i]
        bright = expected > _LIT * level
        if np.count_nonzero(bright & (seen > 0)) >= _FEWEST_SAMPLES:
            top[i] = _top(expected[bright & (seen > 0)], seen[bright & (seen > 0)])
        lit = seen > _LIT * level
        if np.count_nonzero(lit) < _FEWEST_SAMPLES:
            continue
        slopes = length[:, i] * normals
        target = seen - np.sum(aside[:, i] * normals, axis=1)
        shown[i], sigma[i], left[i] = _light(slopes[lit], target[lit], seen[lit])
    return _ImagePrediction(shown, sigma, left, top)


def _top(expected: Float64, seen: Float64) -> float:
    ratio = seen / expected
    brightest = expected >= np.quantile(expected, 1 - _TOP)
    if brightest.all():
        return 1.0
    return float(np.median(ratio[brightest]) / max(float(np.median(ratio[~brightest])), 1e-6))


def _light(slopes: Float64, target: Float64, seen: Float64) -> tuple[Float64, float, float]:
    """Return the light that explains most samples, the sd of its direction, and the deviation."""
    light, weight, products = robust_solution(slopes, target, _STEPS, _HALF_WEIGHT)
    deviation = np.abs(target - slopes @ light)
    relief = np.sqrt(np.maximum(np.linalg.eigvalsh(products / weight.sum()), 0))
    sigma = np.inf
    if relief[0] > _LEAST_RELIEF * relief[2]:
        error = _MAD_TO_SIGMA * float(np.median(deviation))
        sigma = error / float(np.sqrt(_INDEPENDENT) * relief[0] * np.linalg.norm(light))
    return light, float(np.degrees(sigma)), float(np.median(deviation / seen))


@dataclass(frozen=True, eq=False)
class Disagreement:
    """An image that the others do not predict.

    Parameters
    ----------
    image
        Its index.
    kind
        What differs.
    size
        ``brightness`` relative to the prediction; degrees by which a light has ``moved``; index of
        the light that a ``swapped`` image shows; ``clipped``: brightness of the brightest parts
        relative to the rest; rows that are ``striped``; pixels by which an image is ``shifted``;
        ``foreign``: deviation under any light, relative to the signal.
    text
        The same in words, after the name of the image.
    """

    image: int
    kind: Kind
    size: float
    text: str

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class SchemeCheck:
    """Comparison of each image with what the others predict.

    Parameters
    ----------
    found
        The images that disagree, in their order.
    undecided
        Whether so many disagree that it is not known which are right.
    checked
        Whether there were enough images and pixels.
    """

    found: tuple[Disagreement, ...]
    undecided: bool
    checked: bool

    __repr__ = short_repr

    def agreeing(self, count: int) -> list[int]:
        """Return the images of ``count`` that agree; all if it is not known which are right."""
        wrong = set() if self.undecided else {one.image for one in self.found}
        return [i for i in range(count) if i not in wrong]


def check_scheme(cells: Cells, lights: Lights) -> SchemeCheck:
    """Predict each image from the others, and name those that disagree.

    Normals and strengths of all lights are fitted together to about 1,000 cells, so that one wrong
    strength does not change the others; see `fit_strengths`. Each image is then compared with the
    prediction from normals without it: its brightness, the place of its light, its brightest parts,
    its rows, and its position. At least 6 images are required.

    Parameters
    ----------
    cells
        N images.
    lights
        Their N lights.
    """
    count = len(lights)
    places = np.flatnonzero(cells.mask)
    if count < _FEWEST_IMAGES or len(places) < _FEWEST_PIXELS:
        return SchemeCheck((), False, False)
    some = places[:: max(1, -(-len(places) // _PIXELS))]
    vectors = light_vectors(lights, cells.points_mm, some)
    values = cells.values.reshape(count, -1)[:, some].T.astype(np.float64)
    fit = fit_strengths(values, vectors, prior_sd=_PRIOR_SD)
    if fit is None or len(fit.kept) < _FEWEST_PIXELS:
        return SchemeCheck((), False, False)
    middle = vectors.mean(axis=0)
    left = fit.logarithms - _tilt(fit, middle)
    of_frames = _frame_faults(cells, lights, np.exp(fit.logarithms))
    of_lights = _light_faults(fit, middle, lights.ids, _plateaus(cells))
    found = {fault.image: fault for fault in of_lights if fault.kind == "swapped"}
    for fault in (*of_frames, *of_lights, *_brightness_faults(fit, left)):
        found.setdefault(fault.image, fault)
    disagreeing = tuple(found[i] for i in sorted(found))
    undecided = _too_many(len(found), count) or _spread(left) > _SCATTER
    return SchemeCheck(disagreeing, undecided, True)


def _frame_faults(cells: Cells, lights: Lights, strengths: Float64) -> list[Disagreement]:
    found: list[Disagreement] = []
    try:
        predicted = PredictedCells(cells, lights, strengths)
    except EstimateError:
        return found
    for i, rows in enumerate(predicted.stripes()):
        if rows is not None:
            text = f"rows {rows[0]} to {rows[1]} do not belong to it"
            found.append(Disagreement(i, "striped", rows[1] - rows[0] + 1, text))
    for i, (right, down) in enumerate(predicted.shifts_px()):
        size = float(np.hypot(right, down))
        if size:
            text = f"shifted by {right:+.1f} px to the right, {down:+.1f} px down"
            found.append(Disagreement(i, "shifted", size, text))
    return found


def _plateaus(cells: Cells) -> Bool:
    """Return the images of which a larger part than of others has the largest value."""
    share = np.zeros(len(cells.values))
    for i, image in enumerate(cells.values):
        seen = image[cells.mask]
        seen = seen[np.isfinite(seen)]
        if len(seen):
            share[i] = np.mean(seen > _EQUAL * np.quantile(seen, _LARGEST))
    return np.asarray(share > max(_PLATEAU, _PLATEAU_TYPICAL * float(np.median(share))))


def _light_faults(
    fit: StrengthFit, middle: Float64, ids: Sequence[str], plateaus: Bool
) -> list[Disagreement]:
    seen = _predict_images(fit, middle)
    mapped = align(seen.vectors, middle)
    error = angles_deg(mapped, middle)
    typical = float(np.median(error))
    sigma = seen.sigma_deg
    judged = explained(mapped, middle)
    far = judged & (error > np.maximum(max(_MOVED_DEG, _TYPICAL * typical), _SIGMAS * sigma))
    foreign = seen.left > max(_FOREIGN, _FOREIGN_TYPICAL * float(np.median(seen.left)))
    top = np.log(np.maximum(seen.top, 1e-3) / np.median(seen.top))
    lower = top < -max(_CLIPPED, _CLIPPED_TYPICAL * _MAD_TO_SIGMA * float(np.median(np.abs(top))))
    clipped = lower & plateaus
    shown = angles_deg(mapped[:, None], middle[None])
    apart = angles_deg(middle[:, None], middle[None])
    least = max(_SWAPPED_DEG, _SWAPPED_TYPICAL * typical)
    known = _SWAPPED_SIGMAS * np.maximum(sigma[:, None], sigma[None])
    closer = judged & (2 * shown < apart) & (apart > np.maximum(least, known))
    found = []
    for i in range(len(ids)):
        nearest = int(np.argmin(np.where(closer[i], shown[i], np.inf)))
        if closer[i, nearest] and (closer[nearest, i] or (far[i] and shown[i, nearest] < least)):
            text = f"shows the light of {ids[nearest]}"
            found.append(Disagreement(i, "swapped", nearest, text))
        elif foreign[i]:
            text = f"deviates by {seen.left[i]:.0%} of the signal under any light"
            found.append(Disagreement(i, "foreign", float(seen.left[i]), text))
        elif far[i]:
            text = f"its light is {error[i]:.1f} degrees from the given one"
            found.append(Disagreement(i, "moved", float(error[i]), text))
        elif clipped[i]:
            size = float(np.exp(top[i]))
            text = f"its brightest parts are clipped to {size:.0%} of the expected brightness"
            found.append(Disagreement(i, "clipped", size, text))
    return found


def _brightness_faults(fit: StrengthFit, left: Float64) -> list[Disagreement]:
    typical = _spread(left)
    sigma = np.sqrt(np.maximum(np.diag(fit.covariance()), 0))
    # The tilt explains three of few deviations.
    few = len(left) / (len(left) - 3)
    common = few * max(np.log1p(_BRIGHTNESS), _BRIGHTNESS_TYPICAL * typical)
    limit = np.maximum(common, _SIGMAS * sigma)
    found = []
    for i in np.flatnonzero(np.abs(left) > limit):
        size = float(np.exp(left[i]))
        text = f"{size:.2f} times as bright as expected"
        found.append(Disagreement(int(i), "brightness", size, text))
    return found


def _tilt(fit: StrengthFit, middle: Float64) -> Float64:
    """Return the part of the logarithms that a common tilt of all normals explains.

    If all normals m are tilted to m', strengths change by ``(l . m) / (l . m')``.
    """
    mean = np.median(fit.scaled_normals, axis=0)
    mean = mean / np.linalg.norm(mean)
    across = np.linalg.svd(mean[None])[2][1:]
    facing = np.maximum(middle @ mean, 0.05 * np.linalg.norm(middle, axis=1))
    design = np.column_stack([np.ones(len(middle)), (middle @ across.T) / facing[:, None]])
    return np.asarray(design @ _most_agree(design, fit.logarithms))


def _most_agree(design: Float64, values: Float64) -> Float64:
    """Return the coefficients of least Geman-McClure cost: the best of many triples, refined.

    Deviations that no limit names cost little. The tightest half would be a worse choice: gloss
    bends brightness over directions, and a tilt that fits one side exactly misses the other one.
    """
    count, unknown = design.shape
    rng = np.random.default_rng(0)
    triples = rng.permuted(np.tile(np.arange(count), (500, 1)), axis=1)[:, :unknown]
    size = np.abs(np.linalg.det(design[triples]))
    triples = triples[size > 0.05 * size.max()]
    tried = np.linalg.solve(design[triples], values[triples][..., None])[..., 0]
    off = ((values - tried @ design.T) / _HALF_COST) ** 2
    cost = (off / (1 + off)).sum(axis=1)
    found: Float64 = tried[int(np.argmin(cost))]
    for _ in range(20):
        root = 1 / (1 + ((values - design @ found) / _HALF_COST) ** 2)
        found = np.asarray(np.linalg.lstsq(root[:, None] * design, root * values, rcond=None)[0])
    return found


def _spread(left: Float64) -> float:
    """Return the standard deviation of the values that agree, if these are more than half."""
    return float(np.quantile(np.abs(left), _AGREEING)) / _NORMAL_QUANTILE


def _too_many(found: int, count: int) -> bool:
    return found > max(_MOST_IMAGES, _MOST * count)


def scheme_notices(check: SchemeCheck, ids: Sequence[str]) -> list[Notice]:
    """Return one warning for each kind of disagreement, with the names of the images."""
    if check.undecided:
        count = f"{len(check.found)} of {len(ids)} images disagree with the others"
        several = f"the brightness of {len(ids)} images scatters, and no half of them agrees"
        text = (
            f"{count if _too_many(len(check.found), len(ids)) else several}: it is not known which "
            "are right; check lights, exposure times and the order of the images"
        )
        return [Notice("images-undecided", text)]
    notices = []
    for kind, remedy in _REMEDIES.items():
        rows = [one for one in check.found if one.kind == kind]
        if not rows:
            continue
        names = ", ".join(f"{ids[one.image]} ({one.text})" for one in rows[:_LISTED])
        more = f" and {len(rows) - _LISTED} more" if len(rows) > _LISTED else ""
        noun = pluralize(len(rows), "image does", "images do")
        text = f"{noun} not agree with the others: {names}{more}; {remedy}"
        notices.append(Notice(_CODES[kind], text, ", ".join(ids[one.image] for one in rows)))
    return notices


def exclusion(check: SchemeCheck, ids: Sequence[str]) -> list[Notice]:
    """Return what is left out, and why; nothing if it is not known which images are right."""
    if check.undecided or not check.found:
        return []
    reasons = ", ".join(f"{ids[one.image]} ({one.text})" for one in check.found)
    noun = pluralize(len(check.found), "image is", "images are")
    text = f"{noun} left out because the others contradict them: {reasons}"
    return [Notice("images-excluded", text, ", ".join(ids[one.image] for one in check.found))]
