"""Height of an object under near lights: relative from its normals, absolute from the fall-off."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from acquisition import CameraModel, DataError, Lights
from calibration import EstimateError
from processing._reconstruction.coarse_images import CoarseImages, coarse_images
from processing._reconstruction.mean_height_search import MeanHeightSearch
from processing._stereo.method import Method
from processing._stereo.photometric_stereo import photometric_stereo
from processing._surface.height_map import HeightMap
from processing._surface.integration import integrate
from rig import Notice, short_repr

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_MOST_STEPS = 10
# The iteration ends when the surface moves by less, relative to the working distance.
_SETTLED = 1e-5
# Mean heights that are tried, relative to the mean distance of the lights.
_RANGE = (-0.5, 0.5)
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


def near_height(
    values: Float,
    lights: Lights,
    mask: Mask,
    camera: CameraModel,
    *,
    method: Method = "cauchy",
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
    method
        Method of `photometric_stereo` for the normals. The law of the noise of the averages is
        estimated from them.
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
    coarse = coarse_images(values, mask, camera)
    search = MeanHeightSearch(coarse, lights, distance, (lowest, highest), method)
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
            surface = _surface(coarse, lights, depth, method)
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


def _surface(coarse: CoarseImages, lights: Lights, depth: Double, method: Method) -> HeightMap:
    stereo = photometric_stereo(
        coarse.values,
        lights,
        coarse.mask,
        method=method,
        points_mm=coarse.points(depth),
        camera=coarse.camera,
    )
    mean = float(depth[coarse.mask].mean())
    camera = replace(coarse.camera, working_distance_mm=mean)
    return integrate(stereo.normal_map, camera=camera)


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
