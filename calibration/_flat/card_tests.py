"""Tests of a card: shadows, reflections and gloss."""

from __future__ import annotations

import numpy as np

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration._flat.sites import Array, Bools
from calibration._intensities.calibrate import FittedSurfaces
from rig import Notice

# A sample this far from the model, and so many standard deviations, is not noise or grain.
_FAR, _DEVIATIONS = 0.08, 8.0
# Share of the blocks of a light.
_PART = 0.002
_FEWEST = 4
# Exponents of highlights, from a broad sheen to a sharp reflection.
_LOBES = (8.0, 32.0, 128.0, 512.0)
# Sizes of highlights relative to the matte light; the smooth part is wrong by about .14 of them.
_GLOSS, _SHEEN = 0.01, 0.0015
_SIGNIFICANT = 10.0
_LIMIT = 0.5
_ROUNDS = 10


def check_card(fitted: FittedSurfaces, camera: CameraModel, place: str) -> tuple[Notice, ...]:
    """Refuse a card that is shaded, reflects something, or has gloss that moves with the lights.

    A slight sheen is a notice.

    Raises
    ------
    EstimateError
        The message names the light and the pixel.
    """
    residuals, weights, _, _ = fitted.fit.residuals()
    known: Bools = np.asarray((weights > 0).all(axis=0), np.bool_)
    gray = np.where(known, residuals.mean(axis=0), 0.0)
    far = max(_FAR, _DEVIATIONS * fitted.fit.scale)
    fewest = max(_FEWEST, int(_PART * gray.shape[1]))
    for sign, what, remedy in (
        (-1, "darker", "something shades the card: remove it"),
        (1, "brighter", "the card reflects a light or shows an object: use a matte, empty card"),
    ):
        away = sign * gray > far
        count = away.sum(axis=1)
        k = int(count.argmax())
        if count[k] >= fewest:
            size = float(np.quantile(np.abs(gray[k][away[k]]), 0.9))
            where = _pixel(fitted, camera, np.asarray(away[k], np.bool_))
            raise EstimateError(
                f"{place}: near pixel {where}, {count[k] / gray.shape[1]:.1%} of the card are "
                f"{size:.0%} {what} under light {fitted.lights.ids[k]} than under the others; "
                f"{remedy} and record again"
            )
    size, k, p = _gloss(fitted, gray, known, camera)
    if size <= _SHEEN:
        return ()
    one = np.zeros(gray.shape[1], np.bool_)
    one[p] = True
    text = (
        f"it is up to {size:.1%} brighter where it mirrors a light, most under light "
        f"{fitted.lights.ids[k]} near pixel {_pixel(fitted, camera, one)}"
    )
    if size > _GLOSS:
        raise EstimateError(f"{place}: the card is glossy: {text}; use a matte card")
    return (Notice("flat-card-sheen", f"the card has a sheen: {text}; use a more matte card"),)


def _pixel(fitted: FittedSurfaces, camera: CameraModel, blocks: Bools) -> str:
    x, y = np.median(camera.project(fitted.blocks.points_mm[blocks]), axis=0)
    return f"{x:.0f},{y:.0f}"


def _gloss(
    fitted: FittedSurfaces, residuals: Array, known: Bools, camera: CameraModel
) -> tuple[float, int, int]:
    """Return the largest brightening by a highlight, with its light and block; 0 without gloss.

    The highlight of Blinn (1977) is fitted to the residuals, without what strengths, patterns and
    axes of the lights and the albedo have taken from it.
    """
    _, _, _, columns = fitted.fit.residuals()
    of_light = np.concatenate([np.ones_like(columns[:1]), columns]) * known  # (4, K, P)
    taken = [np.linalg.pinv(of_light[:, k].T) for k in range(of_light.shape[1])]
    points = fitted.blocks.points_mm
    light = np.asarray(fitted.lights.positions_mm)[:, None] - points
    light /= np.linalg.norm(light, axis=2, keepdims=True)
    eye = camera.centre_mm - points
    half = light + eye / np.linalg.norm(eye, axis=1, keepdims=True)
    cosine = np.sum(half * fitted.blocks.normals, axis=2) / np.linalg.norm(half, axis=2)
    facing = np.sum(light * fitted.blocks.normals, axis=2)
    clipped = np.clip(residuals, -_LIMIT, _LIMIT)
    spread = 1.4826 * float(np.median(np.abs(clipped[known])))
    best, answer = _SIGNIFICANT, (0.0, 0, 0)
    for exponent in _LOBES:
        # Relative to the matte light, which decreases with the cosine.
        lobe = np.where(known, cosine**exponent / np.maximum(facing, 0.05), 0.0)
        seen = lobe.copy()
        for _ in range(_ROUNDS):
            for i, inverse in enumerate(taken):
                seen[i] -= (inverse @ seen[i]) @ of_light[:, i]
            seen -= seen.sum(axis=0) / np.maximum(known.sum(axis=0), 1)
            seen *= known
        power = float(np.sum(seen**2))
        if power < 1e-12:
            continue
        strength = float(np.sum(seen * clipped)) / power
        certainty = strength * power**0.5 / max(spread, 1e-9)
        if certainty > best:
            k, p = np.unravel_index(int(lobe.argmax()), lobe.shape)
            best, answer = certainty, (strength * float(np.ptp(lobe)), int(k), int(p))
    return answer
