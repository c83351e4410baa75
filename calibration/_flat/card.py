"""The response of lens and sensor from one recording of a card."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError, Lights, Source
from calibration._flat.card_area import card_area
from calibration._flat.card_tests import check_card
from calibration._flat.sites import Array, Bools, Sites
from calibration._intensities.calibrate import FittedSurfaces, fit_surfaces
from calibration._intensities.surface import MatteSurface
from calibration._intensities.vignetting import shift_by_lights
from calibration._radiance.linear_stack import Stack, linear_stack
from calibration._radiance.stack_tasks import Channel
from rig import Notice, Progress

# An even number, so that all bands of a mosaic begin with the same colours.
_ROWS = 64
# Light below this share of the brightest under a light grazes the card, or is beyond its pattern.
_GRAZING = 0.03


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
        Standard deviation of a linear gradient from the middle to a corner, from the lights.
    residual
        Robust relative deviation of the card from the model of its lights.
    lights
        The lights as they were fitted to the card.
    warnings
        Doubts about the recording and the card.
    """

    response: npt.NDArray[np.float32]
    variance: npt.NDArray[np.float32]
    measured: Bools
    gradient_std: float
    residual: float
    lights: Lights
    warnings: tuple[Notice, ...]


def measure_card(
    source: Source, lights: Lights, z_mm: float, mask: Bools | None, on_progress: Progress
) -> CardField:
    """Divide a card by the light of its LEDs; see `calibrate_flat`."""
    camera = source.camera
    if camera is None:
        raise DataError(f"{source.path}: the camera of these images is not known: add a model")
    if source.reduction is not None:
        raise DataError(f"{source.path}: a flat is measured in complete images, not in a region")
    shape, place = source.frames[0].shape, str(source.path)
    sites = Sites(shape, source.cfa)
    channel: Channel = "gray"
    if sites.colours == 3:
        channel = "rgb" if source.cfa is None else "mosaic"
    stack = linear_stack(
        replace(source, lights=None, flat=None), channel=channel, on_progress=on_progress
    )
    order, by_name = lights.match(stack.ids)
    lights = replace(lights.take(order), ids=stack.ids)
    points = camera.points_on_plane(z_mm)
    area = card_area(stack, lights, points, place) if mask is None else mask
    fitted = _fit(stack, sites, camera, lights, z_mm, area)
    sheen = check_card(fitted, camera, place)
    response, variance = _divided(stack, sites, fitted.lights, points)
    measured = (response > 0) & (area if len(shape) == 2 else area[..., None])
    warnings = [*source.warnings, *stack.warnings]
    if not by_name:
        text = "the lights were matched to the images by order, not by name"
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


def _fit(
    stack: Stack, sites: Sites, camera: CameraModel, lights: Lights, z_mm: float, area: Bools
) -> FittedSurfaces:
    """Fit strengths, axes and patterns of the lights to the card, whose albedo is free."""
    values = stack.values
    if sites.cfa is not None:
        # The colours of 2 x 2 sites belong to one place.
        rows, columns = sites.shape[0] // 2, sites.shape[1] // 2
        values = np.zeros((len(values), rows, columns, 3), np.float32)
        for c, name in enumerate("RGB"):
            places = [i for i in range(4) if sites.cfa[i] == name]
            for i in places:
                part = stack.values[:, i // 2 : 2 * rows : 2, i % 2 : 2 * columns : 2]
                values[..., c] += part / np.float32(len(places))
        camera = camera.downscaled(2)
        area = area[: 2 * rows : 2, : 2 * columns : 2] & area[1 : 2 * rows : 2, 1 : 2 * columns : 2]
    return fit_surfaces([MatteSurface.card(values, camera, z_mm=z_mm, mask=area)], lights)


def _divided(
    stack: Stack, sites: Sites, lights: Lights, points_mm: Array
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return the card over the light of its LEDs, and the relative variance of that.

    It is a ratio of sums: the mean of the ratios would be biased, because weights that depend on a
    noisy sample prefer small ones. With a law of the noise, the weights are best; without one, they
    are best if all noise is shot noise, and the variance is from the scatter between the lights.
    """
    shape = stack.values.shape[1:]
    response, variance = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    intensities = np.asarray(lights.intensities)[:, : sites.colours]
    for top in range(0, shape[0], _ROWS):
        rows = slice(top, min(top + _ROWS, shape[0]))
        values = stack.values[:, rows].astype(np.float64)
        light = lights.vectors_at(points_mm[rows])[..., 2]
        light = light[..., None] if len(shape) == 3 else light
        light = light * sites.of_pixels(intensities, rows)
        use = np.isfinite(values) & (light > _GRAZING * light.max())
        values[~use] = 0.0
        light = np.where(use, light, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            found = values.sum(axis=0) / light.sum(axis=0)
            if stack.noise is None:
                many = np.maximum(use.sum(axis=0) - 1, 1)
                square = np.sum((values - light * found) ** 2, axis=0) * (many + 1) / many
                relative = square / values.sum(axis=0) ** 2
            else:
                weights = np.zeros_like(light)
                for k in range(len(light)):
                    expected = light[k] * np.maximum(found, 0)
                    of_one = stack.noise.variance(k, expected, rows.start)
                    weights[k] = np.where(use[k], light[k] / of_one, 0.0)
                precision = (weights * light).sum(axis=0)
                found = (weights * values).sum(axis=0) / precision
                relative = 1 / (precision * found**2)
        good = np.isfinite(found) & (found > 0) & np.isfinite(relative)
        response[rows] = np.where(good, found, 0)
        variance[rows] = np.where(good, relative, 0)
    return response, variance


def _gradient_std(fitted: FittedSurfaces, given: Lights) -> float:
    """Return the standard deviation of a gradient that errors of the lights cause.

    The gradient is the relative change over the distance from the middle to the farthest block.
    Positions without standard deviations count as exact.
    """
    fit, blocks = fitted.fit, fitted.blocks
    _, weights, _, columns = fit.residuals()
    points = blocks.points_mm[:, :2] - blocks.points_mm[:, :2].mean(axis=0)
    points /= np.linalg.norm(points, axis=1).max()
    square = np.sum(points**2, axis=1)
    design = np.column_stack([points, np.ones(len(points)), square, square**2])
    gain = np.linalg.pinv(design)[:2]
    shift = shift_by_lights(fit, weights, columns, gain)
    covariance = shift @ fitted.covariance @ shift.T
    known = None if given.errors is None else given.errors.covariances
    if known is not None:
        # Positions act through the unknowns, which the covariance contains, and directly.
        share = weights.sum(axis=0) / np.maximum(weights.sum(axis=(0, 1)), 1e-300)
        directly = -np.einsum("gp,kp,jkp->gjk", gain, share, np.nan_to_num(fitted.slopes))
        through = np.einsum("gn,njk->gjk", shift, fitted.by_positions)
        for k in np.flatnonzero(np.isfinite(known).all(axis=(1, 2))):
            total, indirect = directly[:, :, k] + through[:, :, k], through[:, :, k]
            covariance += total @ known[k] @ total.T - indirect @ known[k] @ indirect.T
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
