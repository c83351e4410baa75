"""The response of lens and sensor from one recording of a card."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from acquisition import CameraModel, DataError, Lights, Source
from calibration._errors import EstimateError
from calibration.flat.card_means import SmallCard, band_rows, card_area
from calibration.flat.sites import Sites
from calibration.intensities.calibrate import FittedSurfaces, fit_surfaces
from calibration.intensities.fit import shift_by_lights
from calibration.intensities.surface import MatteSurface
from calibration.radiance.image_form import Channel
from calibration.radiance.stack import Stack, open_stack
from rig import Notice, Progress
from rig.arrays import Bool, Float32, Float64

# Light below this share of the brightest at a pixel grazes the card, or is beyond its pattern.
_GRAZING = 0.03
# A sample this far from the model, and so many standard deviations, is not noise or grain.
_FAR, _DEVIATIONS = 0.08, 8.0
# Share of the blocks of a light.
_PART = 0.002
_FEWEST = 4
# Exponents of highlights, from a broad sheen to a sharp reflection.
_LOBES = (8.0, 32.0, 128.0, 512.0)
# Sizes of highlights relative to the matte light; the smooth part is wrong by about 0.14 of them.
_GLOSS, _SHEEN = 0.01, 0.0015
_SIGNIFICANT = 10.0
_LIMIT = 0.5
_ROUNDS = 10


@dataclass(frozen=True, eq=False)
class CardField:
    """What one recording of a card shows.

    Parameters
    ----------
    response
        Response of each pixel times the albedo of the card, the shape of the frames; 0 where it was
        not measured.
    variance
        Its relative variance by temporal noise, the same shape.
    measured
        The pixels that were measured, the same shape.
    gradient_std
        Standard deviation of a linear gradient from the middle to a corner, from the lights; None
        if those of their positions are not known.
    residual
        Robust relative deviation of the card from the model of its lights.
    lights
        The lights as they were fitted to the card.
    warnings
        Doubts about the recording and the card.
    """

    response: Float32
    variance: Float32
    measured: Bool
    gradient_std: float | None
    residual: float
    lights: Lights
    warnings: tuple[Notice, ...]


def measure_card(
    source: Source, lights: Lights, z_mm: float, mask: Bool | None, on_progress: Progress
) -> CardField:
    """Divide a card by the light of its LEDs; see `calibrate_flat`."""
    camera = source.calibrated_camera
    if camera is None:
        raise DataError(f"{source.path}: the camera of these images is not calibrated: add a model")
    if source.reduction is not None:
        raise DataError(f"{source.path}: a flat is measured in complete images, not in a region")
    shape, place = source.frames[0].shape, str(source.path)
    sites = Sites(shape, source.cfa)
    channel: Channel = "gray"
    if sites.colours == 3:
        channel = "rgb" if source.cfa is None else "mosaic"
    plain = replace(source, lights=None, flat=None)
    with open_stack(plain, channel=channel, on_progress=on_progress) as stack:
        order, by_name = lights.match(stack.ids)
        lights = replace(lights.take(order), ids=stack.ids)
        small = SmallCard.read(stack, camera, sites)
        blocks = (
            card_area(small, stack.ids, lights, z_mm, place)
            if mask is None
            else small.reduced(mask)
        )
        surface = MatteSurface.card(small.values, small.camera, z_mm=z_mm, mask=blocks)
        fitted = fit_surfaces([surface], lights)
        sheen = check_card(fitted, camera, place)
        response, variance = _divided(stack, sites, fitted.lights, camera, z_mm)
        doubts = stack.warnings
    area = small.enlarged(blocks, sites.shape[:2]) if mask is None else mask
    measured = (response > 0) & (area if len(shape) == 2 else area[..., None])
    warnings = [*source.warnings, *lights.warnings, *doubts]
    if not by_name:
        text = "the lights were matched to the images by number or order, not by name"
        warnings.append(Notice("lights-matched-by-order", text, place))
    warnings += [replace(notice, where=place) for notice in (*fitted.warnings, *sheen)]
    return CardField(
        np.where(measured, response, np.float32(0)),
        variance,
        measured,
        _gradient_std(fitted, lights),
        fitted.fit.scale,
        fitted.lights,
        tuple(warnings),
    )


def _divided(
    stack: Stack, sites: Sites, lights: Lights, camera: CameraModel, z_mm: float
) -> tuple[Float32, Float32]:
    """Return the card over the light of its LEDs, and the relative variance of that.

    It is a ratio of sums: the mean of the ratios would be biased, because weights that depend on a
    noisy sample prefer small ones. With a law of the noise, the weights are best; without one, they
    are best if all noise is shot noise, and the variance is from the scatter between the lights.
    """
    shape = sites.shape
    response, variance = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    intensities = np.asarray(lights.intensities)[:, : sites.colours]
    for rows, band in stack.bands(band_rows(stack, 2)):
        part = camera.cropped(0, rows.start, camera.width, rows.stop - rows.start)
        light = lights.vectors_at(part.points_on_plane(z_mm))[..., 2]
        light = light[..., None] if len(shape) == 3 else light
        light = light * sites.of_pixels(intensities, rows)
        # The brightest light of each pixel: bands do not matter.
        use = np.isfinite(band.values) & (light > _GRAZING * light.max(axis=0))
        values = np.where(use, band.values, np.float32(0))
        light = np.where(use, light, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            found = values.sum(axis=0, dtype=np.float64) / light.sum(axis=0)
            if band.noise is None:
                many = np.maximum(use.sum(axis=0) - 1, 1)
                square = np.sum((values - light * found) ** 2, axis=0) * (many + 1) / many
                relative = square / values.sum(axis=0, dtype=np.float64) ** 2
            else:
                precision, weighted = np.zeros(found.shape), np.zeros(found.shape)
                for k, of_one in enumerate(light):
                    noise = band.noise.variance(k, of_one * np.maximum(found, 0))
                    weights = np.where(use[k], of_one / noise, 0.0)
                    precision += weights * of_one
                    weighted += weights * values[k]
                found = weighted / precision
                relative = 1 / (precision * found**2)
        good = np.isfinite(found) & (found > 0) & np.isfinite(relative)
        response[rows] = np.where(good, found, 0)
        variance[rows] = np.where(good, relative, 0)
    return response, variance


def _gradient_std(fitted: FittedSurfaces, given: Lights) -> float | None:
    """Return the standard deviation of a gradient that errors of the lights cause.

    The gradient is the relative change over the distance from the middle to the farthest block. It
    is not known if a position has no standard deviations.
    """
    known = None if given.errors is None else given.errors.covariances
    if known is None or not np.isfinite(known).all():
        return None
    fit, blocks = fitted.fit, fitted.blocks
    _, weights, _, columns = fit.residuals()
    points = blocks.points_mm[:, :2] - blocks.points_mm[:, :2].mean(axis=0)
    points /= np.linalg.norm(points, axis=1).max()
    square = np.sum(points**2, axis=1)
    design = np.column_stack([points, np.ones(len(points)), square, square**2])
    gain = np.linalg.pinv(design)[:2]
    shift = shift_by_lights(fit, weights, columns, gain)
    covariance = shift @ fitted.covariance @ shift.T
    # Positions act through the unknowns, which the covariance contains, and directly.
    share = weights.sum(axis=0) / np.maximum(weights.sum(axis=(0, 1)), 1e-300)
    directly = -np.einsum("gp,kp,jkp->gjk", gain, share, np.nan_to_num(fitted.slopes))
    through = np.einsum("gn,njk->gjk", shift, fitted.by_positions)
    for k in range(len(known)):
        total, indirect = directly[:, :, k] + through[:, :, k], through[:, :, k]
        covariance += total @ known[k] @ total.T - indirect @ known[k] @ indirect.T
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))


def check_card(fitted: FittedSurfaces, camera: CameraModel, place: str) -> tuple[Notice, ...]:
    """Refuse a card that is shaded, reflects something, or has gloss that moves with the lights.

    A slight sheen is a notice.

    Raises
    ------
    EstimateError
        The message names the light and the pixel.
    """
    residuals, weights, _, _ = fitted.fit.residuals()
    known: Bool = np.asarray((weights > 0).all(axis=0), np.bool_)
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


def _pixel(fitted: FittedSurfaces, camera: CameraModel, blocks: Bool) -> str:
    x, y = np.median(camera.project(fitted.blocks.points_mm[blocks]), axis=0)
    return f"{x:.0f},{y:.0f}"


def _gloss(
    fitted: FittedSurfaces, residuals: Float64, known: Bool, camera: CameraModel
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
