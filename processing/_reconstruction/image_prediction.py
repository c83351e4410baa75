"""Prediction of the samples of each image from the other images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from processing._reconstruction.strength_fit import StrengthFit, project, solve_normals
from rig import short_repr

Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

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


@dataclass(frozen=True, eq=False)
class ImagePrediction:
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

    vectors: Double
    sigma_deg: Double
    left: Double
    top: Double

    __repr__ = short_repr


def predict_images(fit: StrengthFit, middle: Double) -> ImagePrediction:
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
    return ImagePrediction(shown, sigma, left, top)


def _top(expected: Double, seen: Double) -> float:
    ratio = seen / expected
    brightest = expected >= np.quantile(expected, 1 - _TOP)
    if brightest.all():
        return 1.0
    return float(np.median(ratio[brightest]) / max(float(np.median(ratio[~brightest])), 1e-6))


def _light(slopes: Double, target: Double, seen: Double) -> tuple[Double, float, float]:
    """Return the light that explains most samples, the sd of its direction, and the deviation."""
    weight = np.ones(len(target))
    for _ in range(_STEPS):
        rows = weight[:, None] * slopes
        light = np.asarray(np.linalg.lstsq(rows.T @ slopes, rows.T @ target, rcond=None)[0])
        deviation = np.abs(target - slopes @ light)
        scale = max(_HALF_WEIGHT * float(np.median(deviation)), 1e-6)
        weight = 1 / (1 + (deviation / scale) ** 2)
    relief = np.sqrt(np.maximum(np.linalg.eigvalsh(rows.T @ slopes / weight.sum()), 0))
    sigma = np.inf
    if relief[0] > _LEAST_RELIEF * relief[2]:
        error = _MAD_TO_SIGMA * float(np.median(deviation))
        sigma = error / float(np.sqrt(_INDEPENDENT) * relief[0] * np.linalg.norm(light))
    return light, float(np.degrees(sigma)), float(np.median(deviation / seen))
