"""Edges that face the centre of a circle, and the circles nearby that they support."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.geometry.robust import middle_of
from rig.arrays import Bool, Float32, Float64

_STEPS = 12
_LEADERS = 8
_APART_STEPS = 3.0
_RAYS = (90, 360)
# Edges across a ray, to 25 degrees, may belong to an outline; those of print often do not.
_FACING = 0.9
_SIGNIFICANT = 4.0
_OFFSET_STEP_PX = 0.5
# Every fifth ray shows how steep an image is as well as all of them.
_RAY = 5
_TOLERANCE_PX = 1.0
_OF_IMAGES = 0.5


class EdgesAround:
    """Edges that face the centre of a circle, in polar coordinates around it.

    Parameters
    ----------
    images
        ``(H, W)`` each, above 0; edges are steps of their logarithms. One that half of the images
        show counts like one that all show.
    circle
        The circle.
    reach_px
        Largest difference of the centre and of the radius of circles that are compared.
    """

    def __init__(self, images: Sequence[Float32], circle: Ellipse, reach_px: float) -> None:
        self._circle, self._reach = circle, min(reach_px, 0.3 * circle.radius_px)
        wide = 2.2 * self._reach + 3
        count = int(np.clip(np.pi * circle.radius_px, *_RAYS))
        self._angles = np.arange(count) * (2 * np.pi / count)
        self._first = -np.floor(wide / _OFFSET_STEP_PX) * _OFFSET_STEP_PX
        offsets = np.arange(self._first, -self._first + 0.1, _OFFSET_STEP_PX)
        seen = self._seen(images, offsets)
        self._edges = np.minimum(seen / (_OF_IMAGES * len(images)), 1.0)

    def _seen(self, images: Sequence[Float32], offsets: Float64) -> Float64:
        """Return how many images have an edge, ``(angles, offsets)``."""
        circle, shape = self._circle, np.array(images[0].shape[::-1])
        seen: Float64 = np.zeros((len(self._angles), len(offsets)))
        centre = np.array(circle.centre_px)
        far = circle.radius_px + offsets[-1] + 4
        low = np.maximum((centre - far).astype(int), 0)
        high = np.minimum((centre + far).astype(int) + 2, shape)
        if np.any(high - low < 8):
            return seen
        toward = np.stack([np.cos(self._angles), np.sin(self._angles)], axis=1)
        places = centre + (circle.radius_px + offsets)[None, :, None] * toward[:, None]
        inside = np.all((places > 2) & (places < shape - 3), axis=-1)
        x, y = (np.ascontiguousarray(places[..., k] - low[k], np.float32) for k in (0, 1))
        for image in images:
            crop = np.log(image[low[1] : high[1], low[0] : high[0]])
            seen += self._ridges(crop, x, y, toward.astype(np.float32)) & inside
        return seen

    @staticmethod
    def _ridges(crop: Float32, x: Float32, y: Float32, toward: Float32) -> Bool:
        """Return where the logarithm of an image has an edge that faces the centre."""
        smooth = cv2.GaussianBlur(crop, (0, 0), 0.8)
        gx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
        gy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
        along_x, along_y = (
            cv2.remap(g, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for g in (gx, gy)
        )
        across = np.abs(along_x * toward[:, :1] + along_y * toward[:, 1:])
        steep = np.hypot(along_x, along_y)
        typical = middle_of(steep[::_RAY])
        strong = (across > _SIGNIFICANT * typical + 1e-4) & (across > _FACING * steep)
        ridge = np.zeros_like(strong)
        middle = across[:, 1:-1]
        ridge[:, 1:-1] = (middle >= across[:, :-2]) & (middle > across[:, 2:])
        return np.asarray(ridge & strong)

    def support(self, outline: Ellipse) -> float:
        """Return the share of the circumference where an edge is close to an outline."""
        x, y = np.subtract(outline.centre_px, self._circle.centre_px)
        radius = outline.radius_px - self._circle.radius_px
        near = self._near(_TOLERANCE_PX)
        return float(self._supports(near, np.array([x]), np.array([y]), radius)[0])

    def leaders(self) -> list[Ellipse]:
        """Return the circles with the most support that are apart from each other."""
        steps = np.linspace(-self._reach, self._reach, 2 * int(np.clip(self._reach, 1, _STEPS)) + 1)
        step = float(steps[1] - steps[0])
        near = self._near(max(_TOLERANCE_PX, step))
        changes = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        x, y = changes[:: len(steps), :2].T
        scores = np.stack([self._supports(near, x, y, radius) for radius in steps], axis=1)
        (cx, cy), radius = self._circle.centre_px, self._circle.radius_px
        kept: list[Float64] = []
        for index in np.argsort(-scores.ravel(), kind="stable"):
            trial = changes[index]
            if all(np.abs(trial - other).max() >= _APART_STEPS * step for other in kept):
                kept.append(trial)
            if len(kept) == _LEADERS:
                break
        return [Ellipse((cx + dx, cy + dy), (radius + dr, radius + dr)) for dx, dy, dr in kept]

    def _near(self, tolerance_px: float) -> Float64:
        """Return how close an edge is, ``(angles, offsets)``: 1 at an edge, 0 at the tolerance."""
        reach = max(int(np.ceil(tolerance_px / _OFFSET_STEP_PX)), 1)
        near = self._edges.copy()
        for shift in range(1, reach + 1):
            share = 1 - shift * _OFFSET_STEP_PX / (tolerance_px + _OFFSET_STEP_PX)
            for sign in (1, -1):
                moved = np.roll(self._edges, sign * shift, axis=1)
                near = np.maximum(near, share * moved)
        return np.asarray(near, np.float64)

    def _supports(self, near: Float64, x: Float64, y: Float64, change: float) -> Float64:
        """Return the support of circles of one radius whose centres are moved by x, y ``(H,)``."""
        cosine, sine = (f(self._angles).astype(np.float32) for f in (np.cos, np.sin))
        moves = np.stack([x, y], axis=1).astype(np.float32)
        # On every ray, the place of the circle relative to the first offset, in steps.
        place = (moves @ np.stack([-sine, cosine])) ** 2
        np.subtract(np.float32((self._circle.radius_px + change) ** 2), place, out=place)
        np.sqrt(np.maximum(place, 0, out=place), out=place)
        place += moves @ np.stack([cosine, sine])
        place -= np.float32(self._circle.radius_px + self._first)
        place *= np.float32(1 / _OFFSET_STEP_PX)
        index = np.clip(np.rint(place, out=place), 0, near.shape[1] - 1).astype(np.intp)
        index += np.arange(len(near)) * near.shape[1]
        return np.asarray(near.take(index, mode="clip").mean(axis=1))
