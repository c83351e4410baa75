"""Normals, error bars and gloss of images in colour, in bands of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from acquisition.files import MemoryMaps
from calibration.radiance import luma
from processing.colour.channel_normals import (
    ColourImages,
    ColourMaps,
    laws_of_colours,
    solve_colours,
)
from processing.colour.joint_colours import law_of_joint_samples, solve_jointly
from processing.colour.specular import excess
from processing.images.recorded_images import Band, RowSample
from processing.noise.pixel_variances import (
    Origin,
    PixelVariances,
    Shown,
    SolvedStack,
    origin_of,
    pixel_variances,
    shown_by,
    some_of,
)
from processing.noise.sample_kind import Reason, SampleKind
from processing.recording.banded_normals import ShownBySample, check_lights
from processing.recording.error_bars import ErrorBarMaps, depth_deviation
from processing.recording.examination import Examination
from processing.stereo.image_noise import NoiseLaw
from processing.stereo.method import Method
from rig.arrays import Bool, Float32


class ColourSolver:
    """Solves rows of images in colour; some rows show the law of the noise if it is unknown.

    Parameters
    ----------
    examined, method
        As in `GraySolver`.
    maps
        Maps of the forms of `map_forms`, and ``colour`` for the albedo ``(H, W, 3)``.
    joint
        Whether `solve_jointly` is used; otherwise each colour is solved on its own.
    """

    colour: ClassVar[bool] = True

    def __init__(
        self, examined: Examination, method: Method, maps: MemoryMaps, *, joint: bool
    ) -> None:
        check_lights(examined.lights, examined.points, examined.mask)
        self._examined, self._method, self._joint = examined, method, joint
        self._depth_error = depth_deviation(examined.near, examined.view, examined.mask)
        shape = examined.mask.shape
        self._solutions = ColourMaps.empty(shape, 1 if joint else 3)
        self._maps, self._error_bars = maps, ErrorBarMaps(maps)
        sample = examined.images.sample(examined.mask, colour=True)
        images = self._images(sample)
        self._law = law_of_joint_samples(images, method) if joint else None
        self._laws = [] if joint else laws_of_colours(images, method)
        some = np.zeros_like(sample.mask)
        some.flat[some_of(np.flatnonzero(sample.mask))] = True
        solved = self._solved(replace(images, mask=some))
        self._shown = shown_by_colours(self._judged(images, solved))
        origins = [origin_of(sample.noise, one.law) for one in self._shown]
        origin: Origin = next((one for one in origins if one != "unknown"), "unknown")
        self.shown = ShownBySample(origin, max(one.correlation for one in self._shown))

    def _images(self, part: RowSample) -> ColourImages:
        lights, camera = self._examined.lights, self._examined.source.camera
        points = part.of(self._examined.points)
        return ColourImages(part.values, lights, part.mask, points, part.noise, camera, part.rows)

    def _solved(self, images: ColourImages) -> ColourMaps:
        if self._joint:
            return solve_jointly(images, self._method, self._law)
        return solve_colours(images, self._method, self._laws)

    def _judged(self, images: ColourImages, maps: ColourMaps) -> SolvedStack:
        camera, depth_sigma = self._depth_error
        return SolvedStack(
            values=images.values,
            lights=images.lights,
            mask=images.mask,
            normals=maps.normals,
            albedo=maps.albedo,
            points_mm=images.points_mm,
            camera=camera,
            depth_sigma=depth_sigma,
            noise=images.noise,
        )

    def solve(self, band: Band) -> None:
        """Write the maps of the rows of a band."""
        images = self._images(band.sample)
        maps = self._solved(images)
        self._solutions.write(band.rows, maps, band.inside)
        variances = variances_of_colours(self._judged(images, maps), self._shown)
        ambient = self._examined.ambient
        self._error_bars.write(band.rows, variances, band.inside, maps.normals, ambient)
        known: Bool = np.asarray(maps.normals.any(axis=2))
        values, noise = images.values, images.noise
        law = None if noise is None else NoiseLaw(noise, values.shape[:3])
        above = excess(values, images.model, law, known, maps.normals, luma(maps.albedo))
        self._maps["specular"][band.rows] = above[band.inside]

    def finish(self) -> None:
        """Write the maps of all rows that depend on all bands, or on all colours."""
        everywhere, maps, solved = slice(0, len(self._examined.mask)), self._maps, self._solutions
        maps["normals"][everywhere], maps["colour"][everywhere] = solved.normals, solved.albedo
        maps["albedo"][everywhere] = luma(solved.albedo)
        maps["residual"][everywhere] = solved.residual
        maps["used"][everywhere] = solved.fewest_used()


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


def _averaged(found: list[PixelVariances], normals: Float32) -> PixelVariances:
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
    sums = np.mean([one.sums for one in found], axis=0)
    sums[:, 0] = np.sqrt(model).sum(axis=1, dtype=np.float64)
    sums[:, 1] = np.count_nonzero(noise + lights, axis=1)
    return PixelVariances(
        noise,
        lights,
        height,
        model,
        sums,
        np.asarray(angle**2, np.float32),
        kept,
        None,
        samples,
        reason,
        known[0] if known else "unknown",
        max(one.correlation for one in found),
    )
