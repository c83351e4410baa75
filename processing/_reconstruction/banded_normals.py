"""Normals, error bars and gloss of images in bands of rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Lights
from calibration import StackNoise
from processing._reconstruction.error_bars import depth_deviation, judged
from processing._reconstruction.examination import Examination
from processing._reconstruction.recorded_images import Band, RowSample
from processing._reconstruction.solved_images import SolvedImages
from processing._reconstruction.specular import excess
from processing._stereo.frames import Frames
from processing._stereo.image_noise import ImageLaw, law_of_images
from processing._stereo.light_model import LightModel
from processing._stereo.method import Method
from processing._stereo.noise_law import NoiseLaw
from processing._stereo.photometric_stereo import stereo_of
from processing._stereo.solve import solve_maps
from processing._stereo.stereo_maps import StereoMaps
from processing._uncertainty.normal_uncertainty import NormalUncertainty, as_uncertainty
from processing._uncertainty.pixel_variances import PixelVariances, law_of_errors, pixel_variances
from processing._uncertainty.sample_kind import SampleKind
from rig import Progress, no_progress

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Rows around a pixel on which its error bars depend.
_AROUND = 2


def normals_in_bands(
    examined: Examination, method: Method, on_progress: Progress, rows: int | None = None
) -> SolvedImages:
    """Solve gray images band by band; the result does not depend on the bands.

    Some rows show first the law of the noise, if it is not known, and whether the residuals are
    noise.

    Parameters
    ----------
    examined
        Images, lights and points.
    method
        Method of `photometric_stereo`.
    on_progress
        Receives the stage ``normals``, one step per pixel.
    rows
        Rows of a band; default: as many as need 128 MB.

    Raises
    ------
    EstimateError
        As `photometric_stereo`, or if no pixel is valid.
    """
    images, lights, mask = examined.images, examined.lights, examined.mask
    points_mm, camera, near = examined.points_mm, examined.source.camera, examined.near
    sample = examined.sample()
    LightModel(lights, points_mm, mask).check(mask)
    solver = _Solver(
        lights, method, camera, depth_deviation(near, examined.view, mask), sample, points_mm
    )
    _, shown = solver.variances(sample.values, sample.noise, sample.mask, sample.of(points_mm), 0)
    solver.common_model = shown.common_model
    maps, specular = StereoMaps.empty(mask.shape), np.zeros(mask.shape, np.float32)
    found = _unknown(len(lights), mask.shape, shown)
    del sample, shown
    total, done = int(np.count_nonzero(mask)), 0
    for band in images.bands(mask, _AROUND, rows):
        solver.solve(band, mask, points_mm, maps, specular, found)
        done += int(np.count_nonzero(mask[band.rows]))
        on_progress("normals", done, total)
    stereo = stereo_of(maps, mask, images)
    stereo, uncertainty, doubts = judged(stereo, found, mask)
    specular[~stereo.normal_map.mask] = 0
    return SolvedImages(stereo, uncertainty, specular, (*stereo.warnings, *doubts))


class _Solver:
    """Solves rows of images with one law of the noise."""

    def __init__(
        self,
        lights: Lights,
        method: Method,
        camera: CameraModel | None,
        depth_error: tuple[CameraModel | None, float],
        sample: RowSample,
        points_mm: Double | None,
    ) -> None:
        self._lights = lights
        self._method = method
        self._camera = camera
        self._depth_error = depth_error
        self.common_model = 0.0
        self._law = None
        if sample.noise is None:
            model = LightModel(lights, sample.of(points_mm), sample.mask)
            self._law = law_of_images(Frames(sample.values), model, sample.mask)
        pixels = int(np.count_nonzero(sample.mask))
        self._of_errors = ImageLaw(law_of_errors(self._law, len(lights), pixels))

    def solve(
        self,
        band: Band,
        mask: Mask,
        points_mm: Double | None,
        maps: StereoMaps,
        specular: Float,
        uncertainty: NormalUncertainty,
    ) -> None:
        """Write the maps of the rows of a band."""
        stack, inner, around = band.stack, band.inside, band.around
        points = None if points_mm is None else points_mm[around]
        of_band, variances = self.variances(
            stack.values, stack.noise, mask[around], points, around.start
        )
        for name in ("normals", "albedo", "residual", "used"):
            getattr(maps, name)[band.rows] = getattr(of_band, name)[inner]
        solved = of_band.albedo > 0
        model = LightModel(self._lights, points, solved)
        law = None if stack.noise is None else NoiseLaw(stack.noise, stack.values.shape)
        specular[band.rows] = excess(
            stack.values, model, law, solved, of_band.normals, of_band.albedo
        )[inner]
        found = as_uncertainty(replace(variances, common_model=self.common_model))
        for name in ("sigma_deg", "common_sigma_deg", "reason"):
            getattr(uncertainty, name)[band.rows] = getattr(found, name)[inner]
        uncertainty.samples[:, band.rows] = found.samples[:, inner]

    def variances(
        self,
        values: Float,
        noise: StackNoise | None,
        mask: Mask,
        points_mm: Double | None,
        first_row: int,
    ) -> tuple[StereoMaps, PixelVariances]:
        """Return the maps of some rows, and the variances of their normals."""
        model, frames = LightModel(self._lights, points_mm, mask), Frames(values)
        law: NoiseLaw | Float | None = None
        if noise is not None:
            law = NoiseLaw(noise, values.shape)
        elif self._method != "ls":
            law = self._law
        maps = StereoMaps.empty(mask.shape)
        solve_maps(
            frames, model, mask, law, self._method, maps, self._camera, no_progress, first_row
        )
        return maps, pixel_variances(
            values,
            self._lights,
            mask,
            (maps.normals, maps.albedo),
            points_mm=points_mm,
            camera=self._depth_error[0],
            depth_sigma=self._depth_error[1],
            noise=noise,
            keep_reference=False,
            on_progress=no_progress,
            estimated=self._of_errors,
        )


def _unknown(count: int, shape: tuple[int, ...], sample: PixelVariances) -> NormalUncertainty:
    """Return the error bars of pixels outside the object; the noise is that of a sample."""
    sigma, common = (np.full(shape, np.nan, np.float32) for _ in range(2))
    samples = np.zeros((len(SampleKind), *shape), np.uint8 if count < 256 else np.uint16)
    reason = np.zeros(shape, np.uint8)
    return NormalUncertainty(sigma, common, samples, reason, sample.origin, sample.correlation)
