"""Error bars of normals that are averages over the channels of images in colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Lights
from calibration import StackNoise
from processing._uncertainty.model_error import common_error, deviations
from processing._uncertainty.pixel_variances import (
    PixelVariances,
    Shown,
    pixel_variances,
    shown_by,
)
from processing._uncertainty.sample_kind import Reason, SampleKind
from rig import no_progress

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


def shown_by_colours(
    values: Float,
    lights: Lights,
    mask: Mask,
    normals: Float,
    albedo: Float,
    *,
    points_mm: npt.NDArray[np.float64] | None,
    camera: CameraModel | None,
    depth_sigma: float,
    noise: StackNoise | None,
) -> list[Shown]:
    """Return what each channel shows, see `shown_by`; parameters of `variances_of_colours`."""
    return [
        shown_by(
            np.ascontiguousarray(values[..., channel]),
            lights,
            mask,
            (normals, np.ascontiguousarray(albedo[..., channel])),
            points_mm=points_mm,
            camera=camera,
            depth_sigma=depth_sigma,
            noise=None if noise is None else noise.of_colour(channel),
        )
        for channel in range(values.shape[-1])
    ]


def variances_of_colours(
    values: Float,
    lights: Lights,
    mask: Mask,
    normals: Float,
    albedo: Float,
    *,
    points_mm: npt.NDArray[np.float64] | None,
    camera: CameraModel | None,
    depth_sigma: float,
    noise: StackNoise | None,
    shown: Sequence[Shown],
) -> PixelVariances:
    """Return variances of the averaged normals of three channels.

    The references of the channels are averaged by the reciprocals of their variances. Their noise
    is independent; errors of lights, height and model are the same in all of them. The samples are
    those of the channel with the fewest lit ones. A pixel is valid if it is in any channel.

    Parameters
    ----------
    values
        ``(N, H, W, 3)``.
    normals, albedo
        Averaged normals ``(H, W, 3)``, and the albedo ``(H, W, 3)`` of the channels.
    lights, mask, points_mm, camera, depth_sigma, noise
        As in `normal_uncertainty`.
    shown
        What each channel shows, of these or of other pixels.
    """
    found = [
        pixel_variances(
            np.ascontiguousarray(values[..., channel]),
            lights,
            mask,
            (normals, np.ascontiguousarray(albedo[..., channel])),
            points_mm=points_mm,
            camera=camera,
            depth_sigma=depth_sigma,
            noise=None if noise is None else noise.of_colour(channel),
            keep_reference=True,
            on_progress=no_progress,
            shown=of_channel,
        )
        for channel, of_channel in enumerate(shown)
    ]
    return _averaged(found, normals)


def _averaged(found: list[PixelVariances], normals: Float) -> PixelVariances:
    shape = normals.shape[:2]
    weights = np.zeros((len(found), *shape), np.float32)
    for weight, one in zip(weights, found, strict=True):
        total = one.noise + one.lights
        np.divide(1, total, out=weight, where=(one.reason == Reason.VALID) & (total > 0))
    sums = weights.sum(axis=0)
    np.divide(weights, sums, out=weights, where=sums > 0)
    noise, lights, height, model, kept = (np.zeros(shape, np.float32) for _ in range(5))
    reference = np.zeros_like(normals)
    for weight, one in zip(weights, found, strict=True):
        noise += weight**2 * one.noise
        lights += weight * np.sqrt(one.lights)
        height += weight * np.sqrt(one.height)
        model += weight * np.sqrt(one.model)
        kept += weight * one.kept
        if one.reference is not None:
            reference += weight[..., None] * one.reference
    cross = np.linalg.norm(np.cross(reference, normals), axis=2)
    angle = np.arctan2(cross, np.sum(reference * normals, axis=2))
    fewest = np.argmin([one.samples[SampleKind.LIT] for one in found], axis=0)
    samples = np.choose(fewest, [one.samples for one in found])
    reasons = np.stack([one.reason for one in found])
    valid = (reasons == Reason.VALID).any(axis=0)
    reason = np.where(valid, np.uint8(Reason.VALID), reasons.max(axis=0))
    known = [one.origin for one in found if one.origin != "unknown"]
    lights, height, model = lights**2, height**2, model**2
    return PixelVariances(
        noise,
        lights,
        height,
        model,
        common_error(*deviations(model, noise + lights)),
        np.asarray(angle**2, np.float32),
        kept,
        None,
        samples,
        reason,
        known[0] if known else "unknown",
        max(one.correlation for one in found),
    )
