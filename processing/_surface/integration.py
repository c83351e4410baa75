"""Integration of a normal map to a height map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError
from calibration import EstimateError
from processing._normal_map import NormalMap, check_normal_map
from processing._surface.chord_rule import (
    facing_cosines,
    orthographic_edges,
    perspective_edges,
)
from processing._surface.consistency import SampledSteps, consistency_warning
from processing._surface.grid_graph import divergence, label_parts
from processing._surface.integrability import integrability
from processing._surface.jumps import SHARPNESS, Jumps, solve_with_jumps
from processing._surface.multigrid import solve
from processing._surface.surface_notices import doubts_of_parts, doubts_of_solution
from processing._surface.turns import evenness
from rig import Notice, Progress, no_progress

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]

# A depth that varies by more than this factor cannot be a surface in front of a camera.
_DEPTH_RANGE = 1e6


@dataclass(frozen=True, eq=False)
class HeightMap:
    """A surface over the pixels of an image.

    Parameters
    ----------
    height
        ``(H, W)`` float32 along +Z toward the camera, in `unit`, NaN outside the mask. Without a
        camera the mean over each part is 0; with a camera the height is the working distance minus
        the depth.
    depth
        ``(H, W)`` float32 distance from the camera along the optical axis, in `unit`, NaN outside
        the mask; None for an orthographic surface.
    mask
        ``(H, W)`` bool, the pixels with a known height.
    parts
        ``(H, W)`` int32 number of the connected part of each pixel, from 0; -1 outside the mask.
        The heights of parts relative to each other are not known.
    unit
        ``mm``, or ``px`` if the scale is not known.
    pixel_size
        Distance between neighbouring pixels in `unit`; with a camera, at the working distance.
    camera
        The camera of a perspective surface.
    iterations, relative_residual
        Number of iterations and final residual of the linear solver.
    warnings
        Separate parts, pixels without a height, doubts about the solution, and normals that are
        not those of one surface.
    disagreement_deg
        Median angle between the given normals and those of the surface, along pixel edges.
    curl
        Disagreement of the mixed derivatives of the normals, see `Integrability`: 0 for those of a
        surface. NaN if too few normals face the camera.
    jumps
        Where the surface jumps in depth; None if jumps were not looked for.
    """

    height: Float
    depth: Float | None
    mask: npt.NDArray[np.bool_]
    parts: npt.NDArray[np.int32]
    unit: Literal["mm", "px"]
    pixel_size: float
    camera: CameraModel | None
    iterations: int
    relative_residual: float
    warnings: tuple[Notice, ...]
    disagreement_deg: float = math.nan
    curl: float = math.nan
    jumps: Jumps | None = None

    def __repr__(self) -> str:
        shape = f"{self.height.dtype}{list(self.height.shape)}"
        return f"HeightMap({shape} in {self.unit}, pixel size {self.pixel_size:.4g} {self.unit})"

    def points(self, rows: slice = slice(None)) -> Float:
        """Return the surface points ``(H, W, 3)`` float32 in the house frame, NaN outside.

        Parameters
        ----------
        rows
            Rows of the map; the default is all of them.
        """
        height, columns = self.mask.shape
        inside = self.mask[rows]
        down = np.arange(height)[rows]
        points = np.full((*inside.shape, 3), np.nan, np.float32)
        points[..., 2] = self.height[rows]
        if self.camera is not None and self.depth is not None:
            x, y = np.meshgrid(np.arange(columns), down)
            rays = self.camera.rays(np.stack([x, y], axis=-1))
            points[..., :2] = rays[..., :2] * self.depth[rows, :, None]
        else:
            x = (np.arange(columns) - (columns - 1) / 2) * self.pixel_size
            y = ((height - 1) / 2 - down) * self.pixel_size
            points[..., 0] = np.where(inside, x[None, :], np.nan)
            points[..., 1] = np.where(inside, y[:, None], np.nan)
        return points


def integrate(
    normal_map: NormalMap,
    *,
    camera: CameraModel | None = None,
    pixel_mm: float | None = None,
    depth_mm: Float | None = None,
    discontinuity: bool = False,
    k: float = SHARPNESS,
    on_progress: Progress = no_progress,
) -> HeightMap:
    """Integrate a normal map into a height map by weighted least squares on its mask.

    The chord rule gives a height step for each pair of neighbouring pixels inside the mask (see
    `processing._surface.chord_rule`). The surface that fits all steps best is the solution of a
    Poisson problem on the mask, computed by multigrid-preconditioned conjugate gradients.

    Parameters
    ----------
    normal_map
        The normals. Nothing is assumed outside its mask.
    camera
        A perspective camera of the same image size; without a camera the view is orthographic.
    pixel_mm
        Distance between neighbouring pixels on the object. If the camera has no working distance,
        it is computed from this. Without any scale the result is in pixels: a perspective surface
        then has a mean depth of one focal length.
    depth_mm
        ``(H, W)`` approximate depth, for a camera with a working distance: the mean depth of each
        part is that of these values instead of the working distance.
    discontinuity
        Look for jumps in depth, where one part of the surface hides another, and do not smooth
        across them (see `processing._surface.jumps`). `HeightMap.jumps` says where they are.
    k
        With ``discontinuity``, how small the jumps are that count, in 1/px^2: a step of
        ``1 / sqrt(k)`` pixels begins to be one.
    on_progress
        Receives the stage ``integrating``, in percent.

    Returns
    -------
    HeightMap
        The surface. The mean of each connected part is fixed: height 0 (orthographic), or depth
        equal to the working distance (perspective) or that of ``depth_mm``. Pixels without edges,
        which are isolated or grazing, are not in its mask, and a warning reports them.

    Raises
    ------
    DataError
        If the camera has another image size, the pixel size or ``k`` is not positive, or both
        a pixel size and a working distance are given.
    EstimateError
        If no two neighbouring normals face the camera, or the range of depths is implausible.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, integrate
    >>> x = np.tile(np.arange(6.0), (4, 1))
    >>> slope = NormalMap.from_vectors(np.dstack([0 * x - 1, 0 * x, 0 * x + 1]))  # 45 degrees
    >>> surface = integrate(slope, pixel_mm=0.5)
    >>> surface
    HeightMap(float32[4, 6] in mm, pixel size 0.5 mm)
    >>> surface.height[0].round(3)
    array([-1.25, -0.75, -0.25,  0.25,  0.75,  1.25], dtype=float32)
    """
    check_normal_map("normal_map", normal_map)
    _check_pixel(pixel_mm)
    if not (math.isfinite(k) and k > 0):
        raise DataError(f"a sharpness k of {k} is not positive: 4 is a good value")
    if depth_mm is not None:
        _check_depth(depth_mm, normal_map, camera)
    window = _bounding_box(normal_map.mask)
    normals, inside = normal_map.normals[window], normal_map.mask[window]
    # A kernel is compiled for each layout of its arguments: all windows have the same one.
    contiguous = np.ascontiguousarray(normals), np.ascontiguousarray(inside)
    facing = contiguous[0][..., 2]
    if camera is None:
        edges = orthographic_edges(*contiguous)
    else:
        if camera.size != normal_map.size:
            raise DataError(
                f"a camera of {camera.width} x {camera.height} pixels does not fit a normal map of "
                f"{normal_map.size[1]} x {normal_map.size[0]}: crop or replace the camera"
            )
        y, x = np.mgrid[window]
        rays = camera.rays(np.stack([x, y], axis=-1))
        edges = perspective_edges(*contiguous, rays)
        facing = facing_cosines(contiguous[0], rays)
        del rays, x, y
    even = evenness(*contiguous, edges[:2]) if discontinuity else None
    del contiguous
    right, down, step_right, step_down = edges
    labels, count = label_parts(right, down)
    if count == 0:
        if not (inside[1:] & inside[:-1]).any() and not (inside[:, 1:] & inside[:, :-1]).any():
            rows, columns = normal_map.size
            raise EstimateError(
                f"no two pixels of the normal map of {columns} x {rows} are neighbours, so there "
                "is nothing to integrate: use a larger map, or check its mask"
            )
        raise EstimateError(
            "no two neighbouring pixels of the normal map face the camera, so there is nothing to "
            "integrate: check the axes of the map (Z toward the camera) and its mask"
        )
    sampled = SampledSteps(right, down, step_right, step_down)
    jumps = None
    if even is not None:
        scale = 1.0 if camera is None else camera.focal_px
        facing = np.pad(np.where(inside, facing, 0), 1)
        solution, jumps = solve_with_jumps(
            edges, facing, even, k=k, scale=scale, on_progress=on_progress
        )
        jumps = jumps.placed(window, normal_map.size)
        del step_right, step_down, edges
    else:
        b = divergence(right, down, step_right, step_down)
        del step_right, step_down, edges
        solution = solve(right, down, b, on_progress=on_progress)
    parts = np.full(normal_map.size, -1, np.int32)
    parts[window] = labels[1:-1, 1:-1]
    mask = parts >= 0
    u = solution.u[labels >= 0]
    members = parts[mask]
    height = np.full(normal_map.size, np.nan, np.float32)
    depth: Float | None = None
    unit, pixel_size, distance = _scale(camera, pixel_mm)
    if camera is None:
        height[mask] = pixel_size * (u - _part_means(u, members, count)[members])
    else:
        depths = _relative_depth(u, members, count)
        if depth_mm is None:
            depths *= distance
        else:
            near = depth_mm[mask].astype(np.float64)
            depths *= _part_means(near, members, count)[members]
        depth = np.full(normal_map.size, np.nan, np.float32)
        depth[mask] = depths
        height[mask] = distance - depths
    isolated = int(np.count_nonzero(normal_map.mask & ~mask))
    angle_deg = sampled.disagreement_deg(solution.u, 1.0 if camera is None else -camera.focal_px)
    shape = integrability(normals, inside)
    doubts = consistency_warning(angle_deg, shape)
    return HeightMap(
        height=height,
        depth=depth,
        mask=mask,
        parts=parts,
        unit=unit,
        pixel_size=pixel_size,
        camera=camera,
        iterations=solution.iterations,
        relative_residual=solution.relative_residual,
        warnings=(*doubts_of_parts(parts, isolated, jumps), *doubts_of_solution(solution), *doubts),
        disagreement_deg=angle_deg,
        curl=shape.curl,
        jumps=jumps,
    )


def _check_depth(depth_mm: Float, normal_map: NormalMap, camera: CameraModel | None) -> None:
    if camera is None or camera.working_distance_mm is None:
        raise DataError("approximate depths require a camera with a working distance")
    if depth_mm.shape != normal_map.size or not (depth_mm[normal_map.mask] > 0).all():
        raise DataError(
            f"approximate depths of shape {depth_mm.shape} must be positive at all pixels of a "
            f"normal map of shape {normal_map.size}"
        )


def _bounding_box(mask: npt.NDArray[np.bool_]) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def surface_scale(
    camera: CameraModel | None, pixel_mm: float | None
) -> tuple[Literal["mm", "px"], float]:
    """Return unit and pixel size of the height map that `integrate` would return.

    Parameters
    ----------
    camera, pixel_mm
        As for `integrate`.

    Raises
    ------
    DataError
        If the pixel size is not a positive length, or a pixel size and a camera with a working
        distance are given: each states the scale.

    Examples
    --------
    >>> from processing import surface_scale
    >>> from simulator import bench_camera
    >>> surface_scale(None, 0.1)
    ('mm', 0.1)
    >>> surface_scale(bench_camera(), 0.1)
    Traceback (most recent call last):
        ...
    processing.DataError: a pixel size of 0.1 mm and a camera at 600.0 mm exclude each other: ...
    """
    _check_pixel(pixel_mm)
    return _scale(camera, pixel_mm)[:2]


def _check_pixel(pixel_mm: float | None) -> None:
    if pixel_mm is not None and not (math.isfinite(pixel_mm) and pixel_mm > 0):
        raise DataError(f"a pixel size of {pixel_mm} mm is not a positive length")


def _scale(
    camera: CameraModel | None, pixel_mm: float | None
) -> tuple[Literal["mm", "px"], float, float]:
    """Return unit, pixel size and, with a camera, the working distance in that unit."""
    if camera is None:
        return ("px", 1.0, 0.0) if pixel_mm is None else ("mm", pixel_mm, 0.0)
    focal_px, distance = camera.focal_px, camera.working_distance_mm
    if pixel_mm is not None and distance is not None:
        raise DataError(
            f"a pixel size of {pixel_mm} mm and a camera at {distance} mm exclude each other: give "
            "only one of them"
        )
    if distance is None:
        return ("px", 1.0, focal_px) if pixel_mm is None else ("mm", pixel_mm, pixel_mm * focal_px)
    return "mm", distance / focal_px, distance


def _part_means(values: Double, members: npt.NDArray[np.int32], count: int) -> Double:
    sums = np.bincount(members, values, minlength=count)
    return np.asarray(sums / np.bincount(members, minlength=count), np.float64)


def _relative_depth(u: Double, members: npt.NDArray[np.int32], count: int) -> Double:
    """Return the depths, with mean 1 over each part, from their logarithms."""
    u = u - _part_means(u, members, count)[members]
    if np.abs(u).max() > math.log(_DEPTH_RANGE):
        raise EstimateError(
            f"the depth would vary by more than a factor of {_DEPTH_RANGE:g}: the camera matrix "
            "does not belong to this normal map, or the axes of the map are wrong"
        )
    relative = np.exp(u)
    return np.asarray(relative / _part_means(relative, members, count)[members], np.float64)
