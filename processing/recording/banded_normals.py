"""Normals, error bars and gloss of images in bands of rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from acquisition import Lights
from acquisition.files import Form, Maps
from processing.colour.specular import mean_excess
from processing.images.recorded_images import Band, RowSample
from processing.images.viewing_rays import SurfacePoints
from processing.noise.pixel_variances import (
    Origin,
    VarianceMaps,
    law_of_errors,
    origin_of,
    place_of,
    some_of,
)
from processing.noise.reference_solver import ReferenceSolver, row_blocks
from processing.recording.error_bars import (
    ErrorBarMaps,
    depth_deviation,
    error_bar_forms,
)
from processing.recording.examination import Examination
from processing.stereo.frames import Frames
from processing.stereo.image_noise import NoiseLaw, law_of_images
from processing.stereo.light_model import LightModel
from processing.stereo.method import Method
from processing.stereo.solve import solve_maps, toward_camera, write_solutions
from processing.stereo.stereo_maps import StereoMaps
from rig import Progress, no_progress
from rig.arrays import Bool, Float32, Intp

# Rows around a pixel on which its error bars depend.
_AROUND = 2
# Pixels whose light vectors show whether the lights are in one plane.
_CHECKED = 200


def map_forms(shape: tuple[int, ...], lights: int) -> dict[str, Form]:
    """Return the maps that the solver fills, rows first."""
    of_pixels: dict[str, Form] = {
        "normals": ((*shape, 3), np.float32),
        "albedo": (shape, np.float32),
        "residual": (shape, np.float32),
        "used": (shape, np.uint16),
        "specular": (shape, np.float32),
    }
    return of_pixels | error_bar_forms(shape, lights)


class BandSolver(Protocol):
    """Solves the rows of bands, after it has examined some rows."""

    colour: ClassVar[bool]

    def solve(self, band: Band) -> None:
        """Write the maps of the rows of a band."""


def solve_bands(
    examined: Examination,
    solver: BandSolver,
    on_progress: Progress,
    maps: Maps,
    rows: int | None,
    on_band: Callable[[slice], object],
) -> None:
    """Solve images band by band; the result does not depend on the bands.

    Parameters
    ----------
    examined
        Images, lights and points.
    solver
        Fills the maps.
    on_progress
        Receives the stage ``normals``, one step per pixel.
    maps
        Maps of which the missing rows are filled.
    rows
        Rows of a band; None for as many as need 128 MB.
    on_band
        Receives the rows of each band when they are filled, before they are complete.
    """
    mask = examined.mask
    total, missing = int(np.count_nonzero(mask)), maps.missing("solve", len(mask))
    left = sum(int(np.count_nonzero(mask[part])) for part in missing)
    done = total - left
    on_progress("normals", done, total)
    for part in missing:
        for band in examined.images.bands(mask, _AROUND, rows, part, colour=solver.colour):
            solver.solve(band)
            on_band(band.rows)
            maps.complete("solve", band.rows)
            done += int(np.count_nonzero(mask[band.rows]))
            on_progress("normals", done, total)


def check_lights(lights: Lights, points: SurfacePoints | None, mask: Bool) -> None:
    """Refuse lights that leave a direction of the normal undetermined, by `EstimateError`."""
    pixels = np.flatnonzero(mask)
    pixels = pixels[:: 1 + len(pixels) // _CHECKED]
    some = np.ones((1, len(pixels)), np.bool_)
    LightModel(lights, None if points is None else points.at(pixels)[None], some).check(some)


class ShownBySample(NamedTuple):
    """Where the law of the noise is from, and the correlation of the residuals."""

    origin: Origin
    correlation: float


class _Part(NamedTuple):
    """Rows of gray images, their law of the noise, and the maps of their solution."""

    rows: Intp
    frames: Frames
    model: LightModel
    law: NoiseLaw | None
    maps: StereoMaps
    solver: ReferenceSolver


class GraySolver:
    """Solves rows of gray images with one law of the noise.

    Some rows show the law of the noise, if it is not known, and whether the residuals are noise.
    The samples of a block of pixels are read once, for its normals, error bars and gloss.

    Parameters
    ----------
    examined
        Images, lights and points.
    method
        Method of `photometric_stereo`.
    maps
        Maps of the forms of `map_forms`, and ``first`` and ``last``, the images of these lights, if
        they are there. The first three maps of error bars hold variances.
    """

    colour: ClassVar[bool] = False

    def __init__(self, examined: Examination, method: Method, maps: Maps) -> None:
        check_lights(examined.lights, examined.points, examined.mask)
        self._lights, self._points = examined.lights, examined.points
        self._ambient = examined.ambient
        self._camera, self._method = examined.source.camera, method
        self._depth_error = depth_deviation(examined.near, examined.view, examined.mask)
        self._law: Float32 | None = None
        self._law_of_errors: Float32 | None = None
        self._maps, self._error_bars = maps, ErrorBarMaps(maps)
        self.shown = self._examine(examined.sample())

    def _examine(self, sample: RowSample) -> ShownBySample:
        part, pixels = self._part(sample), np.flatnonzero(sample.mask)
        if sample.noise is None:
            self._law = law_of_images(part.frames, part.model, sample.mask)
            self._law_of_errors = law_of_errors(self._law, len(self._lights), len(pixels))
        some = some_of(pixels)
        correlation = part.solver.correlation(some, *self._estimated(part, some))
        return ShownBySample(origin_of(sample.noise, self._law_of_errors), correlation)

    def _part(self, sample: RowSample) -> _Part:
        points, maps = sample.of(self._points), StereoMaps.empty(sample.mask.shape)
        scaled = (maps.normals, maps.albedo)
        return _Part(
            sample.rows,
            Frames(sample.values),
            LightModel(self._lights, points, sample.mask),
            None if sample.noise is None else NoiseLaw(sample.noise, sample.values.shape),
            maps,
            ReferenceSolver(self._lights, scaled, points, *self._depth_error),
        )

    def _estimated(
        self, part: _Part, pixels: Intp, *, solved: bool = False
    ) -> tuple[Float32, Float32, Float32 | None]:
        """Write the maps of some pixels; return samples, light vectors and the law of their errors.

        Pixels that are ``solved`` have their maps.
        """
        samples, vectors = part.model.samples(part.frames, pixels)
        known = None if part.law is None else part.law.of(pixels, samples, vectors)
        if not solved:
            of_method = known
            if part.law is None and self._method != "ls":
                of_method = self._law
            view = None
            if self._camera is not None:
                view = toward_camera(self._camera, pixels, part.frames.width, part.rows)
            write_solutions(pixels, samples, vectors, of_method, view, self._method, part.maps)
        return samples, vectors, self._law_of_errors if part.law is None else known

    def solve(self, band: Band) -> None:
        """Write the maps of the rows of a band."""
        mask, inner, part = band.sample.mask, band.inside, self._part(band.sample)
        maps, specular = part.maps, np.zeros(mask.shape, np.float32)
        plain = self._method == "ls" and part.law is None
        if plain:
            solve_maps(part.frames, part.model, mask, None, "ls", maps, None, no_progress)
        variances = VarianceMaps(part.solver, maps.albedo, len(self._lights), self.shown.origin)
        for block in row_blocks(np.flatnonzero(mask), mask.shape[1]):
            samples, vectors, known = self._estimated(part, block, solved=plain)
            variances.add(block, samples, vectors, known)
            at = place_of(block)
            of_block = maps.normals.reshape(-1, 3)[at] * maps.albedo.reshape(-1)[at, None]
            of_noise = None if part.law is None else known
            specular.reshape(-1)[at] = mean_excess(samples, vectors, of_noise, of_block)
        for name in ("normals", "albedo", "residual", "used"):
            self._maps[name][band.rows] = getattr(maps, name)[inner]
        self._maps["specular"][band.rows] = specular[inner]
        for name, image in (("first", 0), ("last", -1)):
            if name in self._maps:
                self._maps[name][band.rows] = band.sample.values[image][inner]
        found = variances.variances(self.shown.correlation)
        self._error_bars.write(band.rows, found, inner, maps.normals, self._ambient)
