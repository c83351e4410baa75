"""Corners of a checkerboard to a few thousandths of a pixel, by a fit of two blurred edges.

The mean of gradients (`cv2.cornerSubPix`) errs by some hundredths of a pixel, depending on where
the corner is within its pixel. Such errors are alike in corners of one row, so they do not average.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import erf

from rig.arrays import Float32, Float64

# Place (2), directions of both edges (2), blur, mean, contrast, slope of the light (2).
_PARAMETERS: Final = 9
_ROUNDS: Final = 30
_ENOUGH_PX: Final = 1e-4
_LEAST_BLUR_PX, _MOST_BLUR_RADII, _FIRST_BLUR_PX = 0.2, 0.7, 0.8


def fit_saddles(gray: Float32, starts_px: Float64, edges: Float64, radii_px: Float64) -> Float64:
    """Fit two crossing edges, blurred by a Gaussian, to the disc around each corner.

    Parameters
    ----------
    gray
        ``(H, W)`` image that is proportional to light.
    starts_px
        ``(n, 2)`` corners (x, y) to about a pixel. The discs must be within the image.
    edges
        ``(n, 2)`` directions of both edges in the image, in radians.
    radii_px
        ``(n,)`` radii of the discs, which should hold nothing but the four squares.

    Returns
    -------
    Array
        ``(n, 2)``; NaN where the fit did not settle near the middle of its disc.
    """
    half = int(np.ceil(radii_px.max()))
    reach = np.arange(-half, half + 1)
    whole = np.rint(starts_px)
    columns, rows = (whole.astype(np.int64)[:, k, None, None] for k in (0, 1))
    rows, columns = rows + reach[:, None], columns + reach
    inside = (reach[:, None] ** 2 + reach**2)[None] <= radii_px[:, None, None] ** 2
    height, width = gray.shape
    seen = gray[rows.clip(0, height - 1), columns.clip(0, width - 1)].astype(np.float64)
    count = len(whole)
    weight = inside.reshape(count, -1).astype(np.float64)
    seen = seen.reshape(count, -1)
    x, y = (part.ravel().astype(np.float64) for part in np.meshgrid(reach, reach))
    low = np.where(weight > 0, seen, np.inf).min(axis=1)
    high = np.where(weight > 0, seen, -np.inf).max(axis=1)
    state = np.zeros((count, _PARAMETERS))
    state[:, :2] = starts_px - whole
    state[:, 2:4] = edges
    state[:, 4] = _FIRST_BLUR_PX
    state[:, 5] = (low + high) / 2
    state[:, 6] = (high - low) / 2
    shape, _ = _model(state, x, y)
    sign = np.sum(weight * (seen - state[:, 5, None]) * (shape - state[:, 5, None]), axis=1)
    state[:, 6] *= np.sign(sign)
    return whole + _settled(state, x, y, seen, weight, radii_px)


def _settled(
    state: Float64, x: Float64, y: Float64, seen: Float64, weight: Float64, radii_px: Float64
) -> Float64:
    """Return places relative to the middle of the disc after damped Gauss-Newton steps."""
    damping = np.full(len(state), 1e-3)
    shape, slopes = _model(state, x, y)
    square = np.sum(weight * (seen - shape) ** 2, axis=1)
    step = np.full((len(state), _PARAMETERS), np.inf)
    for _ in range(_ROUNDS):
        weighted = slopes * weight[..., None]
        normal = np.einsum("npi,npj->nij", weighted, slopes)
        toward = np.einsum("npi,np->ni", weighted, seen - shape)
        diagonal = np.einsum("nii->ni", normal)
        normal[:, range(_PARAMETERS), range(_PARAMETERS)] += (
            damping[:, None] * diagonal + 1e-12 * diagonal.max(axis=1, keepdims=True) + 1e-300
        )
        step = np.linalg.solve(normal, toward[..., None])[..., 0]
        tried = state + step
        tried[:, 4] = tried[:, 4].clip(_LEAST_BLUR_PX, _MOST_BLUR_RADII * radii_px)
        tried[:, :2] = tried[:, :2].clip(-radii_px[:, None], radii_px[:, None])
        shape_tried, slopes_tried = _model(tried, x, y)
        square_tried = np.sum(weight * (seen - shape_tried) ** 2, axis=1)
        better = square_tried <= square
        state = np.where(better[:, None], tried, state)
        shape = np.where(better[:, None], shape_tried, shape)
        slopes = np.where(better[:, None, None], slopes_tried, slopes)
        square = np.where(better, square_tried, square)
        damping = np.where(better, damping / 5, damping * 5).clip(1e-9, 1e9)
        if np.all(np.abs(step[:, :2]).max(axis=1) < _ENOUGH_PX):
            break
    done = np.abs(step[:, :2]).max(axis=1) < 10 * _ENOUGH_PX
    done &= np.all(np.abs(state[:, :2]) < radii_px[:, None] / 2, axis=1)
    return np.where(done[:, None], state[:, :2], np.nan)


def _model(state: Float64, x: Float64, y: Float64) -> tuple[Float64, Float64]:
    """Return ``(n, p)`` values and their derivatives ``(n, p, 9)``."""
    cx, cy, first, second, blur, mean, contrast, gx, gy = (part[:, None] for part in state.T)
    dx, dy = x - cx, y - cy
    scale = 1 / (np.sqrt(2) * blur)
    parts = []
    for angle in (first, second):
        sine, cosine = np.sin(angle), np.cos(angle)
        away = (cosine * dy - sine * dx) * scale
        bell = 2 / np.sqrt(np.pi) * np.exp(-(away**2))
        by_angle = -(sine * dy + cosine * dx) * scale
        parts.append((erf(away), bell, sine * scale, -cosine * scale, by_angle, away / blur))
    (e1, b1, x1, y1, a1, s1), (e2, b2, x2, y2, a2, s2) = parts
    light = 1 + gx * dx + gy * dy
    base = mean + contrast * e1 * e2
    lit = contrast * light
    slopes = np.stack(
        [
            lit * (b1 * x1 * e2 + e1 * b2 * x2) - base * gx,
            lit * (b1 * y1 * e2 + e1 * b2 * y2) - base * gy,
            lit * b1 * a1 * e2,
            lit * e1 * b2 * a2,
            -lit * (b1 * s1 * e2 + e1 * b2 * s2),
            np.broadcast_to(light, dx.shape),
            light * e1 * e2,
            base * dx,
            base * dy,
        ],
        axis=-1,
    )
    return base * light, slopes
