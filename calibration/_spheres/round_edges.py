"""Circular edges of an image: votes along the gradients, and radii around the peaks."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from calibration._spheres.ellipse import Ellipse
from calibration._spheres.robust import Array

_SEARCH_SIZE_PX = 700
_SMALLEST_RADIUS_PX = 8
_EDGES = 20000
_CENTRES = 60
_SECTORS = 72
# Less of a circle may be chance.
LEAST_COVERAGE = 0.35
# Radii for which votes are counted at once.
_AT_ONCE = 8


def circular_edges(image: npt.NDArray[np.float32]) -> list[Ellipse]:
    """Return the circular edges of an image, sorted by coverage, then by size, descending."""
    factor = max(1.0, max(image.shape) / _SEARCH_SIZE_PX)
    size = (max(round(image.shape[1] / factor), 1), max(round(image.shape[0] / factor), 1))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    edges, facing = _edges(np.log(small))
    largest = 0.6 * min(small.shape)
    centres = _centres(edges, facing, (small.shape[0], small.shape[1]), largest)
    scored = [
        (coverage, centre, radius)
        for centre in centres
        for radius, coverage in _radii(edges, facing, centre, largest)
    ]
    # If the coverage is similar, the larger circle is the outline and not a mirrored circle.
    scored.sort(key=lambda item: (round(item[0] / 0.25), item[2]), reverse=True)
    scale = image.shape[1] / size[0]
    return [
        Ellipse(
            ((centre[0] + 0.5) * scale - 0.5, (centre[1] + 0.5) * scale - 0.5),
            (radius * scale, radius * scale),
        )
        for _, centre, radius in scored
    ]


def _edges(image: npt.NDArray[np.float32]) -> tuple[Array, Array]:
    """Return edge pixels ``(M, 2)``, maxima along the gradient, and unit gradients ``(M, 2)``."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    gx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
    gy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    strength = np.hypot(gx, gy)
    y, x = np.nonzero(strength > max(3 * float(np.median(strength)), 1e-3))
    facing = np.column_stack([gx[y, x], gy[y, x]]) / strength[y, x, None]
    ahead, behind = (
        _between(strength, x + sign * facing[:, 0], y + sign * facing[:, 1]) for sign in (1, -1)
    )
    ridge = (strength[y, x] >= ahead) & (strength[y, x] > behind)
    # Keep the strongest edges: enough for every circle, few enough for a fast vote.
    keep = np.flatnonzero(ridge)
    keep = keep[np.argsort(strength[y[keep], x[keep]])[-_EDGES:]]
    return np.column_stack([x, y])[keep].astype(np.float64), facing[keep].astype(np.float64)


def _between(image: npt.NDArray[np.float32], x: Array, y: Array) -> Array:
    """Return an image between its pixels, linearly; `cv2.remap` rounds places to 1/32 px."""
    height, width = image.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = (np.minimum(at.astype(np.intp), size - 2) for at, size in ((x, width), (y, height)))
    first = top * width + left
    pixels = image.ravel()
    across, down = x - left, y - top
    upper, lower = (
        pixels[row] + across * (pixels[row + 1] - pixels[row]) for row in (first, first + width)
    )
    between: Array = upper + down * (lower - upper)
    return between


def _centres(
    edges: Array, facing: Array, shape: tuple[int, int], largest: float
) -> list[tuple[float, float]]:
    """Vote along the gradients in both directions, and return the peaks."""
    height, width = shape
    votes = np.zeros(height * width, np.intp)
    at, step = (np.ascontiguousarray(of.T, np.float32) for of in (edges, facing))
    radii = np.arange(_SMALLEST_RADIUS_PX, largest, dtype=np.float32)
    for first in range(0, len(radii), _AT_ONCE):
        some = radii[first : first + _AT_ONCE]
        moves = np.concatenate([some, -some])[:, None, None] * step
        column, row = np.moveaxis(np.rint(np.add(moves, at, out=moves), out=moves), 1, 0)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        place = (row[inside] * width + column[inside]).astype(np.intp)
        votes += np.bincount(place, minlength=len(votes))
    # The error of a vote is proportional to the radius: smooth the votes over a few pixels, and
    # subtract the broad background from clutter.
    plane = cv2.GaussianBlur(votes.reshape(shape).astype(np.float64), (0, 0), 1.5)
    plane = plane - cv2.GaussianBlur(plane, (0, 0), 12.0)
    peaks = []
    for _ in range(_CENTRES):
        _, best, _, (x, y) = cv2.minMaxLoc(plane)
        if best <= 0:
            break
        peaks.append((float(x), float(y)))
        cv2.circle(plane, (x, y), 4, 0.0, -1)
    return peaks


def _radii(
    edges: Array, facing: Array, centre: tuple[float, float], largest: float
) -> list[tuple[float, float]]:
    """Return (radius, coverage) of the circles around a centre.

    The coverage is the share of sectors with an edge that faces the centre.
    """
    offset = edges - centre
    radius = np.linalg.norm(offset, axis=1)
    faces = np.abs(np.sum(offset * facing, axis=1)) > 0.95 * radius
    use = faces & (radius > _SMALLEST_RADIUS_PX) & (radius < largest)
    sector = np.arctan2(offset[use, 1], offset[use, 0]) / (2 * np.pi) * _SECTORS
    hit = np.zeros((int(largest) + 3, _SECTORS), bool)
    hit[radius[use].astype(int), np.floor(sector).astype(int) % _SECTORS] = True
    thick = hit[:-2] | hit[1:-1] | hit[2:]
    coverage = thick.mean(axis=1)
    circles = []
    while coverage.max() > LEAST_COVERAGE:
        best = int(np.argmax(coverage))
        circles.append((best + 1.5, float(coverage[best])))
        coverage[best - 4 : best + 5] = 0.0
    return circles
