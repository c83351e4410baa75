"""Normals, error bars and gloss of images in colour, in bands of rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from acquisition import MemoryMaps
from calibration import StackNoise, luma
from processing._reconstruction.banded_normals import AROUND, ShownBySample, check_lights
from processing._reconstruction.colours import (
    ColourImages,
    ColourMaps,
    laws_of_colours,
    solve_colours,
)
from processing._reconstruction.error_bars import ErrorBarMaps, depth_deviation
from processing._reconstruction.examination import Examination
from processing._reconstruction.joint_colours import law_of_joint_samples, solve_jointly
from processing._reconstruction.recorded_images import Band
from processing._reconstruction.specular import excess
from processing._stereo.method import Method
from processing._stereo.noise_law import NoiseLaw
from processing._uncertainty.colours import shown_by_colours, variances_of_colours
from processing._uncertainty.pixel_variances import Origin, SolvedStack, origin_of, some_of
from rig import Progress

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


def colours_in_bands(
    examined: Examination, method: Method, on_progress: Progress, maps: MemoryMaps, *, joint: bool
) -> ShownBySample:
    """Solve images in colour band by band; the result does not depend on the bands.

    Parameters
    ----------
    examined, method, on_progress
        As in `solve_bands`.
    maps
        Maps of the forms of `map_forms`, and ``colour`` for the albedo ``(H, W, 3)``.
    joint
        Whether `solve_jointly` is used; otherwise each colour is solved on its own.

    Raises
    ------
    EstimateError
        As `photometric_stereo`.
    """
    mask = examined.mask
    check_lights(examined.lights, examined.points, mask)
    solver = _Solver(examined, method, maps, joint=joint)
    total, done = int(np.count_nonzero(mask)), 0
    for band in examined.images.bands(mask, AROUND, colour=True):
        solver.solve(band)
        done += int(np.count_nonzero(mask[band.rows]))
        on_progress("normals", done, total)
    everywhere, solved = slice(0, len(mask)), solver.maps
    maps["normals"][everywhere], maps["colour"][everywhere] = solved.normals, solved.albedo
    maps["albedo"][everywhere] = luma(solved.albedo)
    maps["residual"][everywhere], maps["used"][everywhere] = solved.residual, solved.fewest_used()
    return ShownBySample(solver.origin, solver.correlation)


class _Solver:
    """Solves rows of images in colour; some rows show the law of the noise if it is unknown."""

    def __init__(
        self, examined: Examination, method: Method, filled: MemoryMaps, *, joint: bool
    ) -> None:
        self._examined, self._method, self._joint = examined, method, joint
        self._depth_error = depth_deviation(examined.near, examined.view, examined.mask)
        shape = examined.mask.shape
        self.maps = ColourMaps.empty(shape, 1 if joint else 3)
        self._specular, self._error_bars = filled["specular"], ErrorBarMaps(filled)
        sample = examined.images.sample(examined.mask, colour=True)
        points = sample.of(examined.points)
        images = self._images(sample.values, sample.noise, sample.mask, points, sample.rows)
        self._law = law_of_joint_samples(images, method) if joint else None
        self._laws = [] if joint else laws_of_colours(images, method)
        some = np.zeros_like(sample.mask)
        some.flat[some_of(np.flatnonzero(sample.mask))] = True
        maps = self._solved(replace(images, mask=some))
        self._shown = shown_by_colours(self._judged(images, maps))
        self.correlation = max(one.correlation for one in self._shown)
        origins = [origin_of(sample.noise, one.law) for one in self._shown]
        self.origin: Origin = next((one for one in origins if one != "unknown"), "unknown")

    def _images(
        self,
        values: Float,
        noise: StackNoise | None,
        mask: Mask,
        points_mm: npt.NDArray[np.float64] | None,
        rows: npt.NDArray[np.intp],
    ) -> ColourImages:
        lights, camera = self._examined.lights, self._examined.source.camera
        return ColourImages(values, lights, mask, points_mm, noise, camera, rows)

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
        values, noise, mask = band.stack.values, band.stack.noise, self._examined.mask[band.around]
        surface = self._examined.points
        points = None if surface is None else surface.of(band.around)
        rows = np.arange(band.around.start, band.around.stop)
        images = self._images(values, noise, mask, points, rows)
        maps = self._solved(images)
        self.maps.write(band.rows, maps, band.inside)
        variances = variances_of_colours(self._judged(images, maps), self._shown)
        self._error_bars.write(band.rows, variances, band.inside)
        known: Mask = np.asarray(maps.normals.any(axis=2))
        law = None if noise is None else NoiseLaw(noise, values.shape[:3])
        above = excess(values, images.model, law, known, maps.normals, luma(maps.albedo))
        self._specular[band.rows] = above[band.inside]
