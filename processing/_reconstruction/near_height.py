"""Height of an object under near lights: relative from its normals, absolute from the fall-off."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt
from scipy.optimize import minimize_scalar

from acquisition import CameraModel, DataError, Lights
from calibration import EstimateError
from processing._stereo.light_model import LightModel
from processing._stereo.photometric_stereo import photometric_stereo
from processing._surface.integration import HeightMap, integrate
from rig import Notice, short_repr

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Light vectors change slowly: this many pixels, averages of blocks, show the shape well enough.
_PIXELS = 60_000
# Pixels that show the mean height.
_SAMPLED = 2500
# The albedo and the normal of a pixel explain three samples at any height, and a fourth one hardly
# tests them. Samples count as lit above a share of the brightest one.
_FEWEST_LIT = 5
_LIT = 0.05
_FEWEST_PIXELS = 20
_MOST_STEPS = 10
# The iteration ends when the surface moves by less, relative to the working distance.
_SETTLED = 1e-5
# Mean heights that are tried, relative to the mean distance of the lights.
_RANGE = (-0.5, 0.5)
_TRIED = 21
_ACCURACY_MM = 0.01
# The object stays below this share of the height of the lowest light.
_BELOW_LIGHTS = 0.9
# A mean height with a larger standard deviation, relative to the distance of the lights, is not
# used.
_LEAST_KNOWN = 0.02
# Share of the object that may be below the plane on which it rests.
_LOWEST = 0.005


@dataclass(frozen=True)
class HeightStep:
    """One step of the iteration.

    Parameters
    ----------
    mean_height_mm
        Mean height of the surface above the working plane.
    change_mm
        Root mean square of the changes of heights in this step.
    """

    mean_height_mm: float
    change_mm: float


@dataclass(frozen=True, eq=False)
class NearHeight:
    """Where the surface of an object under near lights is.

    Parameters
    ----------
    depth
        ``(H, W)`` float32 depth of every pixel along the optical axis, mm. Outside the object, that
        of the nearest pixel inside.
    mean_height_mm
        Mean height of the object above the working plane.
    mean_height_sigma_mm
        Its standard deviation, from the scatter of residuals between pixels and between lights; NaN
        if it was given, or follows from the plane on which the object rests.
    steps
        The iteration.
    warnings
        Whether the images do not determine the height.
    """

    depth: Float
    mean_height_mm: float
    mean_height_sigma_mm: float
    steps: tuple[HeightStep, ...]
    warnings: tuple[Notice, ...] = ()

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class _Coarse:
    """The images in averages of ``factor x factor`` pixels."""

    values: Float
    mask: Mask
    camera: CameraModel
    rays: Double
    factor: int

    def points(self, depth: Double) -> Double:
        return np.asarray(self.camera.centre_mm + depth[..., None] * self.rays, np.float64)


def near_height(
    values: Float,
    lights: Lights,
    mask: Mask,
    camera: CameraModel,
    *,
    height_mm: float | None = None,
    rests_on_plane: bool = False,
    on_step: Callable[[int, int], None] = lambda done, total: None,
) -> NearHeight:
    """Find the surface of an object under near lights.

    Normals and height alternate: normals from light vectors at the current surface, and the surface
    from these normals. Its mean height is the one at which a Lambertian surface explains the images
    best, since the irradiance of near lights and its change between pixels depend on it. This runs
    on averages of blocks of pixels; the result is interpolated.

    Parameters
    ----------
    values
        ``(N, H, W)`` float32 linear radiance, also of the sites of a mosaic: an average of sites is
        the same mixture under all lights.
    lights
        N lights with positions.
    mask
        ``(H, W)`` bool, the object.
    camera
        Camera with a working distance.
    height_mm
        Mean height of the object above the working plane, if it is known.
    rests_on_plane
        The object rests on the working plane: its lowest points are at height 0.
    on_step
        Receives the number of steps done, and the largest number.

    Raises
    ------
    DataError
        If both are given, or the height puts the object behind the lights or the camera.
    """
    distance = camera.working_distance_mm
    if distance is None:
        raise DataError("the height under near lights requires a camera with a working distance")
    if height_mm is not None and rests_on_plane:
        raise DataError("an object that rests on the plane has no other height: give one of them")
    lowest, highest = _limits(lights, distance)
    if height_mm is not None and not lowest < height_mm < highest:
        raise DataError(
            f"a height of {height_mm:g} mm puts the object behind lights or camera: give a height "
            f"from {lowest:.0f} to {highest:.0f} mm"
        )
    coarse = _coarse(values, mask, camera)
    search = _Search(coarse, lights, distance, (lowest, highest))
    depth = np.full(coarse.mask.shape, distance - (height_mm or 0.0))
    sigma = math.nan
    steps: list[HeightStep] = []
    for step in range(_MOST_STEPS):
        before = depth
        try:
            if height_mm is None and not rests_on_plane:
                depth, sigma = search.moved(depth)
                if not sigma < _LEAST_KNOWN * search.light_distance_mm:
                    return _not_determined(mask, distance, sigma)
            surface = _surface(coarse, lights, depth)
        except EstimateError:
            return _not_determined(mask, distance - (height_mm or 0.0), math.nan)
        inside = surface.mask
        if surface.depth is None:
            raise AssertionError("a surface in front of a camera has a depth")
        found = surface.depth[inside].astype(np.float64)
        if height_mm is not None:
            found *= (distance - height_mm) / found.mean()
        elif rests_on_plane:
            found *= distance / np.quantile(found, 1 - _LOWEST)
        depth = _filled(found, inside)
        height = float(distance - found.mean())
        change = float(np.sqrt(np.mean((depth - before)[inside] ** 2)))
        steps.append(HeightStep(height, change))
        on_step(step + 1, _MOST_STEPS)
        # At steep rims the steps may alternate between two surfaces.
        if change < _SETTLED * distance or (step and change > 0.5 * steps[-2].change_mm):
            break
    whole = _enlarged(depth, coarse.factor, mask.shape)
    return NearHeight(whole, steps[-1].mean_height_mm, sigma, tuple(steps))


def _limits(lights: Lights, distance: float) -> tuple[float, float]:
    """Return the lowest and the highest mean height that is possible."""
    positions = np.asarray(lights.positions_mm)
    away = float(np.mean(np.linalg.norm(positions, axis=1)))
    highest = min(_RANGE[1] * away, _BELOW_LIGHTS * distance)
    above = positions[positions[:, 2] > 0, 2]
    if len(above):
        highest = min(highest, _BELOW_LIGHTS * float(above.min()))
    return _RANGE[0] * away, highest


def _coarse(values: Float, mask: Mask, camera: CameraModel) -> _Coarse:
    """Average blocks; a block with a missing sample or a pixel outside the mask is left out."""
    factor = max(1, math.isqrt(int(np.count_nonzero(mask)) // _PIXELS))
    while True:
        height, width = (size // factor for size in mask.shape)
        blocks = mask[: height * factor, : width * factor].reshape(height, factor, width, factor)
        inside = np.asarray(blocks.all(axis=(1, 3)), np.bool_)
        if factor == 1 or np.count_nonzero(inside) * factor**2 > 0.5 * np.count_nonzero(mask):
            break
        factor -= 1
    small = camera.downscaled(factor) if factor > 1 else camera
    if factor > 1:
        size = (width, height)
        averages = np.zeros((len(values), height, width), np.float32)
        for image, out in zip(values, averages, strict=True):
            part = image[: height * factor, : width * factor]
            # Averages of whole blocks; NaN spreads to its block.
            cv2.resize(part, size, dst=out, interpolation=cv2.INTER_AREA)
    else:
        averages = values
    return _Coarse(averages, inside, small, small.pixel_rays(), factor)


def _surface(coarse: _Coarse, lights: Lights, depth: Double) -> HeightMap:
    stereo = photometric_stereo(
        coarse.values, lights, coarse.mask, method="cauchy", points_mm=coarse.points(depth)
    )
    mean = float(depth[coarse.mask].mean())
    camera = replace(coarse.camera, working_distance_mm=mean)
    return integrate(stereo.normal_map, camera=camera)


class _Search:
    """Finds the mean height of a surface of known shape."""

    def __init__(
        self, coarse: _Coarse, lights: Lights, distance: float, limits: tuple[float, float]
    ) -> None:
        flat = coarse.values.reshape(len(coarse.values), -1)
        pixels = np.flatnonzero(coarse.mask)
        pixels = pixels[_lit(flat[:, pixels]) >= _FEWEST_LIT]
        self._pixels = pixels[:: max(1, len(pixels) // _SAMPLED)]
        self._values = np.ascontiguousarray(flat[:, self._pixels][:, None])
        measured = np.maximum(np.nan_to_num(self._values[:, 0]), 0)
        self._brightness = np.maximum(measured.mean(axis=0), np.finfo(np.float32).tiny)[:, None]
        self._rays = coarse.rays.reshape(-1, 3)[self._pixels]
        self._centre = coarse.camera.centre_mm
        self._lights = lights
        self._distance = distance
        self._limits = limits
        positions = np.asarray(lights.positions_mm)
        self.light_distance_mm = float(np.mean(np.linalg.norm(positions, axis=1)))
        self._scale = 1.0
        self._spacing = (limits[1] - limits[0]) / (_TRIED - 1)
        # The best mean height so far.
        self._found: float | None = None

    def moved(self, depth: Double) -> tuple[Double, float]:
        """Return the depth at the best mean height, and the standard deviation of the height."""
        if len(self._pixels) < _FEWEST_PIXELS:
            return depth, math.inf
        shape = depth.reshape(-1)[self._pixels]
        mean = float(shape.mean())
        relative = shape / mean
        residuals = self._residuals(relative, self._distance - mean)
        known = residuals[np.isfinite(residuals)]
        if not known.size:
            return depth, math.inf
        self._scale = max(1.4826 * float(np.median(np.abs(known))), 1e-6)

        def cost(height: float) -> float:
            return float(self._costs(relative, height).sum())

        bracket = self._bracket(cost)
        if bracket is None:
            return depth, math.inf
        height = float(
            minimize_scalar(
                cost, bounds=bracket, method="bounded", options={"xatol": _ACCURACY_MM}
            ).x
        )
        self._found = height
        return depth * ((self._distance - height) / mean), self._sigma(relative, height)

    def _bracket(self, cost: Callable[[float], float]) -> tuple[float, float] | None:
        """Return heights around the best one; None if it is at a limit."""
        if self._found is not None:
            # The surface has moved by a few millimetres since.
            return self._found - self._spacing / 2, self._found + self._spacing / 2
        tried = np.linspace(*self._limits, _TRIED)
        best = int(np.argmin([cost(height) for height in tried]))
        if best in (0, _TRIED - 1):
            return None
        return float(tried[best - 1]), float(tried[best + 1])

    def _sigma(self, relative: Double, height: float) -> float:
        """Return the standard deviation of a minimum.

        Slopes of the cost scatter between pixels by noise, and between lights also by errors of the
        lights, which are common to all pixels (a sandwich estimate, by clusters; White, 1982).
        """
        step = max(0.002 * self.light_distance_mm, 10 * _ACCURACY_MM)
        below, here, above = (self._costs(relative, height + shift) for shift in (-step, 0.0, step))
        curvature = float(np.sum(above + below - 2 * here)) / step**2
        if not curvature > 0:
            return math.inf
        slopes = (above - below) / (2 * step)
        variances = []
        for axis in (0, 1):
            of_one = slopes.sum(axis=axis)
            free = max(len(of_one) - 4, 1) / len(of_one)
            variances.append(float(np.sum((of_one - of_one.mean()) ** 2)) / free)
        return math.sqrt(max(variances)) / curvature

    def _costs(self, relative: Double, height: float) -> Double:
        """Return the cost of each sample ``(P, N)`` at a mean height, 0 where it is missing."""
        ratio = self._residuals(relative, height) / self._scale
        measured = np.isfinite(ratio)
        cost = np.log1p(np.where(measured, ratio, 0.0) ** 2)
        # A pixel counts alike, however many samples it has.
        return np.asarray(cost / np.maximum(measured.sum(axis=1), 1)[:, None], np.float64)

    def _residuals(self, relative: Double, height: float) -> Double:
        """Return residuals ``(P, N)`` relative to the brightness, NaN where a sample is missing.

        Residuals relative to the albedo would be smaller at lower heights, as is the irradiance.
        """
        depth = relative * (self._distance - height)
        points = (self._centre + depth[:, None] * self._rays)[None]
        every = np.ones(points.shape[:2], np.bool_)
        try:
            solved = photometric_stereo(
                self._values, self._lights, every, method="cauchy", points_mm=points
            )
        except EstimateError:
            return np.full((len(depth), len(self._values)), np.nan)
        model = LightModel(self._lights, points, every)
        samples, vectors = model.samples(self._values, np.arange(len(depth)))
        normals, albedo = solved.normal_map.normals[0], solved.albedo[0]
        shading = np.maximum(np.einsum("pc,pcn->pn", normals, vectors), 0)
        residuals = samples - albedo[:, None] * shading
        residuals[albedo == 0] = np.nan
        return np.asarray(residuals / self._brightness, np.float64)


def _lit(samples: Float) -> npt.NDArray[np.intp]:
    """Return the number of lights that reach each pixel, from samples ``(N, P)``."""
    bright = np.nan_to_num(samples, nan=0.0, posinf=0.0, neginf=0.0)
    return np.asarray((bright > _LIT * bright.max(axis=0)).sum(axis=0), np.intp)


def _filled(depth: Double, inside: Mask) -> Double:
    """Return a depth for all pixels: outside, that of the nearest one inside."""
    whole = np.zeros(inside.shape)
    whole[inside] = depth
    rows, columns = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return np.asarray(whole[rows, columns], np.float64)


def _enlarged(depth: Double, factor: int, shape: tuple[int, ...]) -> Float:
    """Interpolate averages of blocks to all pixels."""
    if factor == 1:
        return depth.astype(np.float32)
    rows, columns = depth.shape
    size = (columns * factor, rows * factor)
    found = cv2.resize(depth.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    # Rows and columns that fill no block.
    below, right = shape[0] - size[1], shape[1] - size[0]
    whole = cv2.copyMakeBorder(found, 0, below, 0, right, cv2.BORDER_REPLICATE)
    return np.asarray(whole, np.float32)


def _not_determined(mask: Mask, depth: float, sigma: float) -> NearHeight:
    """Return a plane, with a notice."""
    text = (
        "the images do not determine how high the object is: its normals are those of points in a "
        "plane; state the height, or that the object rests on the working plane"
    )
    plane = np.full(mask.shape, depth, np.float32)
    return NearHeight(plane, 0.0, sigma, (), (Notice("height-not-determined", text),))
