"""Normals of a point cloud, fitted to neighbourhoods, and rendering to a raster of pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from calibration import EstimateError
from processing._projection.point_cloud_kernels import splat
from processing._projection.point_cloud_orient import orient
from processing._projection.rasterize import NEAR_SHARE, Drawn
from processing._projection.rasterize_kernels import BAND_ROWS, sort_into_bands
from processing._projection.view import Raster
from rig import Notice, Progress, in_threads, no_progress

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]

# Number of points whose neighbours are processed together; it limits the memory.
_CHUNK = 100_000
# A neighbourhood is a line if its relative spread across the line is below this.
_LINE = 1e-6
# Weight of the regularisation of the quadric's coefficients, relative to the neighbours.
_RIDGE = 1e-6
# Number of points within a disc; enough to leave no holes between random points.
_POINTS_IN_DISC = 8
# Largest disc of an isolated point, as a multiple of the median disc.
_LARGEST_DISC = 3.0
# Cosine of the angle between line of sight and normal above which the normal of a visible point
# certainly faces the viewer.
_SURELY_FACING = 0.5


@dataclass(frozen=True, eq=False)
class Surfels:
    """Points with small discs that represent the surface around them.

    Parameters
    ----------
    points_mm
        ``(N, 3)``.
    normals
        ``(N, 3)`` float64 unit vectors, of either sign.
    bends_per_mm
        ``(N, 3, 3)`` change of the normal per mm along the surface.
    radii_mm
        ``(N,)`` radii of discs that contain eight points each.
    warnings
        Points that were left out.
    """

    points_mm: Double
    normals: Double
    bends_per_mm: Double
    radii_mm: Double
    warnings: tuple[Notice, ...]


def fit_surfels(
    points_mm: Double,
    normals: Double | None = None,
    neighbours: int = 16,
    on_progress: Progress = no_progress,
) -> Surfels:
    """Fit the surface around every point to its nearest neighbours.

    The first fit is a plane at right angles to the direction of least spread (Hoppe et al., Surface
    reconstruction from unorganized points, 1992). The second is a quadric over that plane: its
    slope corrects the normal, and its curvature gives the change of the normal (Cazals and Pouget,
    Estimating differential quantities using polynomial fitting of osculating jets, 2005).

    Parameters
    ----------
    points_mm
        ``(N, 3)``, finite.
    normals
        ``(N, 3)`` unit vectors if they are known; then only their change is fitted.
    neighbours
        Number of points to which a surface is fitted, including the point itself. More points give
        a smoother surface.
    on_progress
        Receives the stage ``fitting normals``, one step per point.

    Returns
    -------
    Surfels
        Surfels without duplicates and without points whose neighbours are on a line; a warning
        reports both.

    Raises
    ------
    EstimateError
        If there are fewer than three different points, or all points are on a line.
    """
    points, index = np.unique(points_mm, axis=0, return_index=True)
    warnings = []
    if len(points) < len(points_mm):
        text = f"points left out because they are duplicates: {len(points_mm) - len(points)}"
        warnings.append(Notice("points-duplicate", text))
    if len(points) < 3:
        raise too_few_points(len(points))
    count = min(neighbours, len(points))
    tree = cKDTree(points)
    fitted = np.zeros(points.shape)
    bends = np.zeros((len(points), 3, 3))
    reach = np.zeros(len(points))
    sound = np.zeros(len(points), np.bool_)
    on_progress("fitting normals", 0, len(points))
    for begin in range(0, len(points), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        distance, near = map(np.asarray, tree.query(points[part], count))
        reach[part] = distance[:, -1]
        offset = points[near] - points[part, None]
        weight = np.exp(-2 * (distance / np.maximum(distance[:, -1:], 1e-300)) ** 2)
        spread, axes = _plane(offset, weight)
        sound[part] = spread[:, 1] > _LINE**2 * spread[:, 2]
        fitted[part], bends[part] = _quadric(offset, weight, axes)
        on_progress("fitting normals", min(begin + _CHUNK, len(points)), len(points))
    if normals is not None:
        agree = np.where((fitted * normals[index]).sum(axis=1) < 0, -1.0, 1.0)
        fitted, bends = normals[index], bends * agree[:, None, None]
        sound[:] = True
    if not sound.any():
        raise EstimateError("all points are on a line: no normal can be fitted")
    if not sound.all():
        text = f"points left out because their neighbours are on a line: {int((~sound).sum())}"
        warnings.append(Notice("points-on-a-line", text))
    radii = reach * math.sqrt(_POINTS_IN_DISC / count)
    radii = np.minimum(radii, _LARGEST_DISC * np.median(radii))
    return Surfels(points[sound], fitted[sound], bends[sound], radii[sound], tuple(warnings))


def too_few_points(different: int) -> EstimateError:
    """Return the error for a cloud with too few different points."""
    return EstimateError(
        f"too few different points ({different}): a normal requires at least three"
    )


def _plane(offset: Double, weight: Double) -> tuple[Double, Double]:
    """Return the spreads ``(n, 3)``, ascending, and the axes ``(n, 3, 3)`` of neighbourhoods."""
    weight = (weight / weight.sum(axis=1, keepdims=True))[..., None]
    centred = offset - (weight * offset).sum(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", weight * centred, centred))
    return np.maximum(spread, 0), axes


def _quadric(offset: Double, weight: Double, axes: Double) -> tuple[Double, Double]:
    """Return the normals ``(n, 3)`` and bends ``(n, 3, 3)`` of quadrics over the planes."""
    normal, u, v = axes[:, :, 0], axes[:, :, 1], axes[:, :, 2]
    # Scaling by the size of the neighbourhood keeps the systems well conditioned.
    size = np.maximum(np.abs(offset).max(axis=(1, 2)), 1e-300)
    x, y, z = (np.einsum("nki,ni->nk", offset, axis) / size[:, None] for axis in (u, v, normal))
    terms = np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2], axis=-1)
    weighted = weight[..., None] * terms
    system = np.einsum("nki,nkj->nij", weighted, terms)
    # Coefficients that too few neighbours leave undetermined become 0.
    system += _RIDGE * weight.sum(axis=1)[:, None, None] * np.eye(6)
    right = np.einsum("nki,nk->ni", weighted, z)
    _, p, q, xx, xy, yy = np.linalg.solve(system, right[..., None])[..., 0].T
    normal = normal - p[:, None] * u - q[:, None] * v
    length = np.linalg.norm(normal, axis=1)
    bend = np.zeros((len(u), 3, 3))
    for a, b, curvature in ((u, u, xx), (u, v, xy), (v, u, xy), (v, v, yy)):
        bend -= (curvature / (length * size))[:, None, None] * a[:, :, None] * b[:, None, :]
    return normal / length[:, None], bend


def draw_points(surfels: Surfels, raster: Raster) -> Drawn:
    """Draw the discs nearest to the viewer and blend them where they overlap.

    Parameters
    ----------
    surfels
        Points in the house frame. The normals of visible points are oriented toward the viewer.
        This orientation is propagated to the other points, and those that face away are not drawn.
    raster
        The pixels. Discs are enlarged to cover at least one pixel.

    Returns
    -------
    Drawn
        The image. The outline of the object extends up to one disc beyond its last points.

    Raises
    ------
    EstimateError
        If all points are behind the camera.
    """
    points, warnings = surfels.points_mm, list(surfels.warnings)
    normals, bends, radii = surfels.normals, surfels.bends_per_mm, surfels.radii_mm
    toward = np.array([0.0, 0.0, 1.0])
    scale_px = np.full(len(points), 1 / raster.pixel_mm)
    if raster.camera is not None:
        depth = raster.eye_mm - points[:, 2]
        before = depth > NEAR_SHARE * raster.eye_mm
        if not before.all():
            text = f"points left out because they are behind the camera: {int((~before).sum())}"
            warnings.append(Notice("points-behind-camera", text))
        if not before.any():
            raise EstimateError(
                "all points are behind the camera: check the working distance and the unit"
            )
        points, normals, bends = points[before], normals[before], bends[before]
        radii = radii[before]
        toward = np.array([0.0, 0.0, raster.eye_mm]) - points
        scale_px = raster.eye_mm / (depth[before] * raster.pixel_mm)
    facing = np.where((normals * toward).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    normals, bends = facing * normals, facing[:, :, None] * bends
    radii = np.maximum(radii, 0.75 / scale_px)
    pixels, _ = raster.pixels(points)
    rows, columns = raster.size
    # Toward the corners of a wide-angle image a disc appears larger than in the middle.
    reach_px = radii * scale_px * (1.0 if raster.camera is None else 1.5) + 1
    inside = (np.abs(pixels[:, 0] - (columns - 1) / 2) < columns / 2 + reach_px) & (
        np.abs(pixels[:, 1] - (rows - 1) / 2) < rows / 2 + reach_px
    )
    first = (np.clip(pixels[:, 1] - reach_px, 0, rows - 1) // BAND_ROWS).astype(np.int16)
    last = (np.clip(pixels[:, 1] + reach_px, 0, rows - 1) // BAND_ROWS).astype(np.int16)
    sights = raster.sights()

    def blend(shown: npt.NDArray[np.bool_]) -> tuple[Float, Float]:
        members, begin = sort_into_bands(
            np.where(shown, first, np.int16(1)),
            np.where(shown, last, np.int16(0)),
            -(-rows // BAND_ROWS),
        )
        out = np.zeros((rows, columns, 3), np.float32)
        height = np.full((rows, columns), np.nan, np.float32)
        in_threads(
            splat, len(begin) - 1, points, normals, bends, radii, pixels, reach_px, members, begin,
            BAND_ROWS, *sights, raster.eye_mm, out, height,
        )  # fmt: skip
        return out, height

    out, height = blend(inside)
    cosine = (normals * toward).sum(axis=1) / np.linalg.norm(toward, axis=-1)
    row = np.clip(np.rint(pixels[:, 1]), 0, rows - 1).astype(np.intp)
    column = np.clip(np.rint(pixels[:, 0]), 0, columns - 1).astype(np.intp)
    nearest = np.nan_to_num(height[row, column], nan=np.inf)
    front = inside & (cosine > _SURELY_FACING) & (points[:, 2] >= nearest - radii)
    if front.any():
        # Points on the far side of the outline would show the inside of the surface.
        out, height = blend(inside & ((orient(points, normals, front) * toward).sum(axis=1) >= 0))
    return Drawn(out, height, tuple(warnings))
