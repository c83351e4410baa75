"""Error bars of normals that are averages over the channels of images in colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from processing._uncertainty.pixel_variances import (
    PixelVariances,
    Shown,
    SolvedStack,
    common_error,
    deviations,
    pixel_variances,
    shown_by,
)
from processing._uncertainty.sample_kind import Reason, SampleKind

Float = npt.NDArray[np.float32]


def shown_by_colours(given: SolvedStack) -> list[Shown]:
    """Return what each channel of images in colour shows, see `shown_by`."""
    return [shown_by(one) for one in given.of_colours()]


def variances_of_colours(given: SolvedStack, shown: Sequence[Shown]) -> PixelVariances:
    """Return variances of the averaged normals of three channels.

    The references of the channels are averaged by the reciprocals of their variances. Their noise
    is independent; errors of lights, height and model are the same in all of them. The samples are
    those of the channel with the fewest lit ones. A pixel is valid if it is in any channel.

    Parameters
    ----------
    given
        The images in colour and their solution.
    shown
        What each channel shows, of these or of other pixels.
    """
    found = [
        pixel_variances(one, shown=of_channel, keep_reference=True)
        for one, of_channel in zip(given.of_colours(), shown, strict=True)
    ]
    return _averaged(found, given.normals)


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
