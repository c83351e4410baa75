"""A first placement of two fields by features that neither light nor turning changes."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import cv2
import numpy as np

from processing.registration.field import Field, fine, reduced
from rig.arrays import Float32, Float64

# Features are searched in images of at most this many pixels along a side.
_MOST_PX: Final = 900
_WIDTHS_PX: Final = (1.0, 6.0)
_MOST_FEATURES: Final = 4000
# Lowe's ratio (2004) of the distances to the best and to the second match.
_RATIO: Final = 0.8
_NEAR_PX: Final = 3.0
# Of unrelated fields, up to 3 agree.
FEWEST_MATCHES: Final = 10


class FeatureMatch(NamedTuple):
    """A similarity ``(3, 3)`` from pixels of a first field to a second, and how many agree."""

    matrix: Float64
    agreeing: int


class Features(NamedTuple):
    """Features of a field: positions ``(F, 2)`` in its pixels, and descriptors by kind.

    They were found in an image whose pixels are ``size`` pixels of the field.
    """

    points: tuple[Float64, ...]
    descriptors: tuple[Float32, ...]
    size: int


def features_of(field: Field, size: int | None = None, mirrored: bool = False) -> Features:
    """Return features of the curvature and of the albedo, both independent of lights and turning.

    Parameters
    ----------
    field
        The field.
    size
        Size of the blocks in pixels; default: so that the image has at most 900 on a side.
    mirrored
        Find the features of the mirror image.
    """
    if size is None:
        size = math.ceil(max(field.mask.shape) / _MOST_PX)
    structure = reduced(field.structure, size)
    if mirrored:
        structure = structure[:, :, ::-1].copy()
        structure[0] *= -1
    known = np.isfinite(structure[:2]).all(axis=0)
    slopes = np.where(known, structure[:2], np.float32(0))
    smooth = [cv2.GaussianBlur(slope, (0, 0), _WIDTHS_PX[0]) for slope in slopes]
    curvature = np.gradient(smooth[0], axis=1) - np.gradient(smooth[1], axis=0)
    inner = cv2.erode(np.asarray(known, np.uint8), np.ones((5, 5), np.uint8)) > 0
    scalars = [np.where(inner, curvature, np.nan)]
    if len(structure) > 2:
        scalars.append(fine(structure[2:], _WIDTHS_PX[1])[0])
        scalars[-1] = np.where(inner, scalars[-1], np.nan)
    sift = cv2.SIFT.create(nfeatures=_MOST_FEATURES, contrastThreshold=0.02)
    points, descriptors = [], []
    for scalar in scalars:
        found, described = sift.detectAndCompute(_even(scalar), inner.astype(np.uint8))
        at = np.array([one.pt for one in found], np.float64).reshape(-1, 2)
        points.append(at * size + (size - 1) / 2)
        descriptors.append(
            np.zeros((0, 128), np.float32)
            if described is None
            else np.sqrt(described / np.maximum(described.sum(axis=1, keepdims=True), 1e-9))
        )
    return Features(tuple(points), tuple(descriptors), size)


def match(first: Features, second: Features, *, scale: bool) -> FeatureMatch | None:
    """Return the placement on which most features agree, None without one.

    Parameters
    ----------
    first, second
        Features of two fields.
    scale
        Whether the scales may differ.
    """
    here, there = [], []
    for k in range(min(len(first.points), len(second.points))):
        a, b = first.descriptors[k], second.descriptors[k]
        if len(a) < 2 or len(b) < 2:
            continue
        for pair in cv2.BFMatcher().knnMatch(a, b, k=2):
            if pair[0].distance < _RATIO * pair[1].distance:
                here.append(first.points[k][pair[0].queryIdx])
                there.append(second.points[k][pair[0].trainIdx])
    if len(here) < FEWEST_MATCHES:
        return None
    near = _NEAR_PX * max(first.size, second.size)
    cv2.setRNGSeed(1)
    affine, inside = cv2.estimateAffinePartial2D(
        np.array(here),
        np.array(there),
        method=cv2.RANSAC,
        ransacReprojThreshold=near,
        maxIters=20_000,
        confidence=0.9999,
    )
    if affine is None:
        return None
    factor = math.sqrt(abs(np.linalg.det(affine[:, :2])))
    if not scale and not 0.9 < factor < 1.1:
        return None
    # A feature may be matched in both channels, or several times at one place.
    distinct = np.unique(np.rint(np.array(here)[inside.ravel() > 0] / near), axis=0)
    matrix = np.vstack([affine, [0, 0, 1]])
    return FeatureMatch(matrix, len(distinct))


def _even(scalar: Float32) -> np.ndarray:
    """Return an image of 8 bits with even contrast."""
    known = np.isfinite(scalar)
    values = np.where(known, scalar, 0).astype(np.float32)
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), 20)
    power = cv2.GaussianBlur(values**2, (0, 0), 20) / np.maximum(weight, 1e-3)
    least = 0.1 * float(np.median(power[known])) if known.any() else 1.0
    even = values / np.sqrt(np.maximum(power, max(least, 1e-12)))
    return np.clip(128 + 40 * even, 0, 255).astype(np.uint8)
