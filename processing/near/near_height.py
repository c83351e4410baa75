"""Height of an object under near lights: relative from its normals, absolute from the fall-off."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from acquisition import DataError, Lights
from calibration import EstimateError
from processing.images.coarse_images import CoarseImages, coarse_images
from processing.images.recorded_images import Images
from processing.images.viewing_rays import SurfacePoints, View
from processing.near.mean_height_search import (
    MeanHeightSearch,
    raised,
)
from processing.noise.normal_errors import STRUCTURED
from processing.stereo.method import Method
from processing.stereo.normals_and_albedo import photometric_stereo
from rig import Notice, Progress, short_repr
from rig.arrays import Bool, Float32, Float64

_MOST_STEPS = 10
# The iteration ends when the surface moves by less, relative to the distance of the lights.
_SETTLED = 1e-5
# Mean heights that are tried, relative to the mean distance of the lights.
_RANGE = (-0.5, 0.5)
# The object stays below this share of the height of the lowest light.
_BELOW_LIGHTS = 0.9
# A mean height with a larger standard deviation, relative to the distance of the lights, is not
# used.
_LEAST_KNOWN = 0.02
# Standard deviations of a common shift of the lights that are reported.
_DOUBTFUL = 4.0
# A smaller one, relative to the distance of the lights, is not.
_SLIGHT = 5e-4
# A stated height may differ from the one that the images show by this share of the distance of the
# lights: lowest points are those of an integrated surface.
_CONTRADICTED = 0.005
# Rise of all lights that is tried, relative to their distance, and steps until the surface follows.
_TRIED_RISE = 0.01
_RISE_STEPS = 3
# Share of the object that may be below the plane on which it rests, or behind the lights.
_LOWEST = 0.005
# Lights that a normal requires, and pixels at which they are counted.
_FEWEST_LIGHTS = 3
_CHECKED = 2500


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
        ``(H, W)`` float32 depth of every pixel along the optical axis, mm: from the camera, or for
        parallel rays from the working plane. Outside the object, that of the nearest pixel inside.
    mean_height_mm
        Mean height of the object above the working plane.
    mean_height_sigma_mm
        Its standard deviation, from the scatter of residuals between pixels and between lights, and
        from the stated errors of the positions of the lights, as if all lights shared them; NaN if
        the height was given, or follows from the plane on which the object rests.
    lowest_mm
        Height above the working plane that 0.5 % of the object are below.
    steps
        The iteration.
    warnings
        Whether the images do not determine the height, or contradict it.
    """

    depth: Float32
    mean_height_mm: float
    mean_height_sigma_mm: float
    lowest_mm: float
    steps: tuple[HeightStep, ...]
    warnings: tuple[Notice, ...] = ()

    __repr__ = short_repr


def near_height(
    values: Images,
    lights: Lights,
    mask: Bool,
    view: View,
    *,
    method: Method = "best",
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
    view
        How the pixels see the surface.
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
    EstimateError
        If the surface at the stated height is partly behind the lights.
    """
    if height_mm is not None and rests_on_plane:
        raise DataError("an object that rests on the plane has no other height: give one of them")
    lowest, highest = height_limits(lights, view)
    if height_mm is not None and not lowest < height_mm < highest:
        raise DataError(
            f"a height of {height_mm:g} mm puts the object behind lights or camera: give a height "
            f"from {lowest:.0f} to {highest:.0f} mm"
        )
    coarse = coarse_images(values, mask, view)
    search = MeanHeightSearch(coarse, lights, (lowest, highest))
    distance = view.distance_mm
    depth = np.full(coarse.mask.shape, distance - (height_mm or 0.0))
    sigma = math.nan
    steps: list[HeightStep] = []
    for step in range(_MOST_STEPS):
        before = depth
        try:
            if height_mm is None and not rests_on_plane:
                depth, sigma = search.moved(depth)
            found, inside = _surface(coarse, lights, depth, method)
        except EstimateError:
            return _not_determined(mask, distance - (height_mm or 0.0), math.nan)
        if height_mm is not None:
            found = view.moved(found, float(found.mean()), distance - height_mm)
        elif rests_on_plane:
            found = view.moved(found, float(np.quantile(found, 1 - _LOWEST)), distance)
        depth = _filled(found, inside)
        height = float(distance - found.mean())
        if height_mm is not None or rests_on_plane:
            _check_reach(coarse, lights, depth, height)
        change = float(np.sqrt(np.mean((depth - before)[inside] ** 2)))
        steps.append(HeightStep(height, change))
        on_step(step + 1, _MOST_STEPS)
        # At steep rims the steps may alternate between two surfaces.
        if change < _SETTLED * search.light_distance_mm or (
            step and change > 0.5 * steps[-2].change_mm
        ):
            break
    if sigma >= _LEAST_KNOWN * search.light_distance_mm:
        return _not_determined(mask, distance, sigma)
    warnings: tuple[Notice, ...] = ()
    if math.isfinite(sigma):
        warnings = _doubts(*search.common_shift(depth), search.light_distance_mm)
        sigma = math.hypot(sigma, _common_sigma(search, depth, method))
    else:
        warnings = _contradiction(search, depth, method)
    whole = _enlarged(depth, coarse.factor, mask.shape)
    lowest = float(distance - np.quantile(depth[inside], 1 - _LOWEST))
    return NearHeight(whole, steps[-1].mean_height_mm, sigma, lowest, tuple(steps), warnings)


def height_limits(lights: Lights, view: View) -> tuple[float, float]:
    """Return the lowest and the highest mean height that is possible."""
    positions = np.asarray(lights.positions_mm)
    away = float(np.mean(np.linalg.norm(positions, axis=1)))
    highest = min(_RANGE[1] * away, _BELOW_LIGHTS * view.highest_mm)
    above = positions[positions[:, 2] > 0, 2]
    if len(above):
        highest = min(highest, _BELOW_LIGHTS * float(above.min()))
    return _RANGE[0] * away, highest


def _check_reach(coarse: CoarseImages, lights: Lights, depth: Float64, height: float) -> None:
    """Refuse a surface of which a part is behind the lights."""
    pixels = np.flatnonzero(coarse.mask)
    some = pixels[:: max(1, len(pixels) // _CHECKED)]
    vectors = lights.vectors_at(coarse.points(depth).reshape(-1, 3)[some])
    behind = np.count_nonzero(vectors.any(axis=2), axis=0) < _FEWEST_LIGHTS
    if np.mean(behind) > _LOWEST:
        raise EstimateError(
            f"a mean height of {height:.0f} mm puts {np.mean(behind):.0%} of the object behind the "
            f"lights: fewer than {_FEWEST_LIGHTS} of them reach it; check the height, and the "
            "positions and axes of the lights"
        )


def _surface(
    coarse: CoarseImages, lights: Lights, depth: Float64, method: Method
) -> tuple[Float64, Bool]:
    stereo = photometric_stereo(
        coarse.values,
        lights,
        coarse.mask,
        method=method,
        points_mm=coarse.points(depth),
        camera=coarse.view.seen_by,
    )
    mean = float(depth[coarse.mask].mean())
    return coarse.view.surface(stereo.normal_map, mean)


def _filled(depth: Float64, inside: Bool) -> Float64:
    """Return a depth for all pixels: outside, that of the nearest one inside."""
    whole = np.zeros(inside.shape)
    whole[inside] = depth
    # Imported here: it takes 0.2 s, and only near lights need it.
    from scipy.ndimage import distance_transform_edt

    rows, columns = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return np.asarray(whole[rows, columns], np.float64)


def _enlarged(depth: Float64, factor: int, shape: tuple[int, ...]) -> Float32:
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


def _common_sigma(search: MeanHeightSearch, depth: Float64, method: Method) -> float:
    """Return the standard deviation of the mean height if all lights share their stated errors.

    Calibrations do not state which part of their errors is common, for instance that of the
    distance: this is the upper bound. Lights that are all higher are tried.
    """
    errors = search.lights.errors
    if errors is None or errors.covariances is None:
        return 0.0
    known = errors.covariances[np.isfinite(errors.covariances).all(axis=(1, 2)), 2, 2]
    if not known.any():
        return 0.0
    rise = _TRIED_RISE * search.light_distance_mm
    higher = search.under(raised(search.lights, rise))
    moved = depth
    try:
        for _ in range(_RISE_STEPS):
            moved, _ = higher.moved(moved)
            found, inside = _surface(search.coarse, higher.lights, moved, method)
            moved = _filled(found, inside)
    except EstimateError:
        return 0.0
    change = float(np.mean((moved - depth)[inside]))
    return abs(change) / rise * float(np.sqrt(known.mean()))


def _doubts(best: float, sigma: float, light_distance: float) -> tuple[Notice, ...]:
    """Return a notice if images would agree better under lights that are all higher or lower."""
    if not abs(best) > max(_DOUBTFUL * sigma, _SLIGHT * light_distance):
        return ()
    text = (
        "the mean height may be wrong by more than its standard deviation: the images would agree "
        f"better if all lights were {'higher' if best > 0 else 'lower'}, so their positions or "
        "the distance of the camera are off alike, or the surface is not matte"
    )
    return (Notice("height-doubtful", text),)


def _contradiction(search: MeanHeightSearch, depth: Float64, method: Method) -> tuple[Notice, ...]:
    """Return a notice if the images show that the object is lower than stated.

    A broad highlight makes an object look higher by up to 20 mm, and may leave no residual. So an
    object that looks higher than stated is not judged, nor one whose residuals are alike under
    neighbouring lights.
    """
    moved, sigma = search.moved(depth)
    if not sigma < _LEAST_KNOWN * search.light_distance_mm:
        return ()
    correlation = search.neighbour_correlation(moved)
    if not correlation < STRUCTURED:
        return ()
    off = search.mean_height(moved) - search.mean_height(depth)
    sigma = math.hypot(sigma, _common_sigma(search, moved, method))
    if -off < max(_DOUBTFUL * sigma, _CONTRADICTED * search.light_distance_mm):
        return ()
    text = (
        f"the images show the object {-off:.1f} mm lower than stated (standard deviation "
        f"{sigma:.1f} mm): the stated height, the positions of the lights or the distance of the "
        "camera is wrong, or the object does not rest on the plane"
    )
    return (Notice("height-contradicted", text),)


def _not_determined(mask: Bool, depth: float, sigma: float) -> NearHeight:
    """Return a plane, with a notice."""
    text = (
        "the images do not determine how high the object is: its normals are those of points in a "
        "plane; state the height, or that the object rests on the working plane"
    )
    plane = np.full(mask.shape, depth, np.float32)
    return NearHeight(plane, 0.0, sigma, 0.0, (), (Notice("height-not-determined", text),))


@dataclass(frozen=True, eq=False)
class Heights:
    """Where the surface is, from the images."""

    view: View | None
    mask: Bool
    height_mm: float | None
    rests_on_plane: bool
    method: Method
    on_progress: Progress

    @property
    def stated(self) -> bool:
        """Whether the height does not have to be found."""
        return self.height_mm is not None or self.rests_on_plane

    def of(self, values: Images, lights: Lights) -> tuple[NearHeight | None, SurfacePoints | None]:
        """Return the height under near lights and the points; None under distant lights."""
        if self.view is None:
            return None, None
        near = near_height(
            values,
            lights,
            self.mask,
            self.view,
            method=self.method,
            height_mm=self.height_mm,
            rests_on_plane=self.rests_on_plane,
            on_step=lambda done, total: self.on_progress("height", done, total),
        )
        return near, SurfacePoints(self.view, near.depth, self.mask.shape)
