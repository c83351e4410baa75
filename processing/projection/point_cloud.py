"""Normals of a point cloud, fitted to neighbourhoods, and rendering to a raster of pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from scipy.ndimage import binary_erosion
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from calibration import EstimateError
from processing.projection.geometry_files import counted
from processing.projection.rasterize import NEAR_SHARE, Drawn
from processing.projection.rasterize_kernels import BAND_ROWS, sort_into_bands
from processing.projection.view import Raster
from rig import Notice, Progress, in_threads, no_progress
from rig.arrays import Bool, Float32, Float64, Int32, Int64, Intp
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Smallest cosine between line of sight and normal that is used to intersect a disc: the
# intersection of a grazing ray would be far away.
_GRAZING = 0.1
# Tangent of the largest change of a normal within its disc.
_MOST_BENT = 0.5
_NEIGHBOURS = 8
# Keeps paths short if all normals are parallel.
_STEP = 1e-3
# Number of points whose neighbours are processed together; it limits the memory.
_CHUNK = 100_000
# A neighbourhood is a line if its relative spread across the line is below this.
_LINE = 1e-6
# Below this, the points of a line scanner have mostly neighbours on their own line, and above the
# second value also on those next to it. Random points are above 0.1, but for one in thousands.
_OF_LINES, _ACROSS_LINES = 0.02, 0.1
# Share of such points that makes a cloud one of lines, and the most neighbours that are tried.
_SHARE_OF_LINES, _MOST_NEIGHBOURS = 0.1, 1024
# A point is isolated if its neighbours are farther away than this many times those of most points,
# and no chain of points that are neighbours of each other leads to it.
_ISOLATED = 5.0
# Isolated points are outliers if they are few; else the cloud is just uneven.
_MOST_OUTLIERS = 0.05
# Normals of the file are doubtful if half of them differ from fitted ones by more than this, in
# degrees; unit vectors that are all the same, such as colours, if by more than the second value.
_DOUBTFUL_DEG, _DOUBTFUL_SAME_DEG = 45.0, 5.0
# A neighbourhood is flat, so that its normal is certain, if its relative spread across it is below.
_FLAT = 0.05
# Share of the outline that discs should cover; random points reach 99 %.
_LEAST_COVERED = 0.9
_POINTS_IN_CELL = 16
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
        Points that were left out, or need more neighbours than requested; normals of the file that
        are not used.
    """

    points_mm: Float64
    normals: Float64
    bends_per_mm: Float64
    radii_mm: Float64
    warnings: tuple[Notice, ...]


def fit_surfels(
    points_mm: Float64,
    normals: Float64 | None = None,
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
    text = "points left out because they are duplicates"
    warnings = counted(Notice("points-duplicate", text), len(points_mm) - len(points))
    if len(points) < 3:
        raise too_few_points(len(points))
    count = min(neighbours, len(points))
    tree = cKDTree(points)
    fitted = np.zeros(points.shape)
    bends = np.zeros((len(points), 3, 3))
    reach = np.zeros(len(points))
    sound = np.zeros(len(points), np.bool_)
    on_progress("fitting normals", 0, len(points))
    shape = np.zeros(points.shape)

    def fit(which: Intp, reached: int) -> None:
        # Of many neighbours every second, fourth, ... is used: they span as much, in less time.
        every = max(reached // (2 * count), 1)
        distance, near = (
            np.asarray(each)[:, every - 1 :: every] for each in tree.query(points[which], reached)
        )
        reach[which] = distance[:, -1]
        offset = points[near] - points[which, None]
        weight = np.exp(-2 * (distance / np.maximum(distance[:, -1:], 1e-300)) ** 2)
        shape[which], axes = _plane(offset, weight)
        sound[which] = shape[which, 1] > _LINE**2 * shape[which, 2]
        fitted[which], bends[which] = _quadric(offset, weight, axes)

    for begin in range(0, len(points), _CHUNK):
        fit(np.arange(begin, min(begin + _CHUNK, len(points))), count)
        on_progress("fitting normals", min(begin + _CHUNK, len(points)), len(points))
    along = np.flatnonzero(shape[:, 1] < _OF_LINES * shape[:, 2])
    if len(along) > _SHARE_OF_LINES * len(points):
        most = count
        lines = len(along)
        while len(along) and 2 * most <= min(len(points), _MOST_NEIGHBOURS):
            most *= 2
            for begin in range(0, len(along), _CHUNK // 2):
                fit(along[begin : begin + _CHUNK // 2], most)
            along = along[shape[along, 1] < _ACROSS_LINES * shape[along, 2]]
        text = (
            f"points in lines: {lines} of {len(points)}; their normals are fitted to up to {most} "
            "neighbours"
        )
        warnings.append(Notice("points-in-lines", text))
    if normals is not None:
        off_deg = _median_angle_deg(normals[index], fitted, shape)
        same = (np.ptp(normals, axis=0) < 1e-3).all()
        if off_deg > (_DOUBTFUL_SAME_DEG if same else _DOUBTFUL_DEG):
            text = (
                f"the unit vectors in the file differ by {off_deg:.0f} degrees (median) from the "
                "normals of the points, which are used instead: they may be colours"
            )
            warnings.append(Notice("point-normals-doubtful", text))
            normals = None
    if normals is not None:
        agree = np.where((fitted * normals[index]).sum(axis=1) < 0, -1.0, 1.0)
        fitted, bends = normals[index], bends * agree[:, None, None]
        sound[:] = True
    if not sound.any():
        raise EstimateError("all points are on a line: no normal can be fitted")
    text = "points left out because their neighbours are on a line"
    warnings += counted(Notice("points-on-a-line", text), int((~sound).sum()))
    radii = reach * math.sqrt(_POINTS_IN_DISC / count)
    radii = np.minimum(radii, _LARGEST_DISC * np.median(radii))
    isolated = _isolated(tree, reach, count)
    text = "points left out because they are far from all others"
    warnings += counted(Notice("points-isolated", text), int(isolated.sum()))
    sound &= ~isolated
    return Surfels(points[sound], fitted[sound], bends[sound], radii[sound], tuple(warnings))


def _median_angle_deg(given: Float64, fitted: Float64, shape: Float64) -> float:
    """Return the median angle between normals of either sign where the fitted ones are certain."""
    flat = shape[:, 0] < _FLAT * shape[:, 1]
    if flat.sum() < len(flat) / 2:
        return 0.0
    crossed = np.linalg.norm(np.cross(given[flat], fitted[flat]), axis=1)
    along = np.abs((given[flat] * fitted[flat]).sum(axis=1))
    return float(np.degrees(np.median(np.arctan2(crossed, along))))


def _isolated(tree: cKDTree, reach: Float64, count: int) -> Bool:
    """Return the mask of the few points that are far from all others."""
    isolated = np.zeros(len(reach), np.bool_)
    lone = np.flatnonzero(reach > _ISOLATED * np.median(reach))
    if not 0 < len(lone) <= _MOST_OUTLIERS * len(reach):
        return isolated
    distance, near = map(np.asarray, tree.query(tree.data[lone], count))
    linked = distance <= np.minimum(reach[lone, None], reach[near])
    # One more point represents all that are not lone.
    place = np.full(len(reach), len(lone))
    place[lone] = np.arange(len(lone))
    row, column = np.nonzero(linked)
    links = coo_array(
        (np.ones(len(row), np.int8), (row, place[near[row, column]])),
        shape=(len(lone) + 1, len(lone) + 1),
    )
    _, part = connected_components(links, directed=False)
    isolated[lone[part[:-1] != part[-1]]] = True
    return isolated


def too_few_points(different: int) -> EstimateError:
    """Return the error for a cloud with too few different points."""
    return EstimateError(
        f"too few different points ({different}): a normal requires at least three"
    )


def _plane(offset: Float64, weight: Float64) -> tuple[Float64, Float64]:
    """Return the spreads ``(n, 3)``, ascending, and the axes ``(n, 3, 3)`` of neighbourhoods."""
    weight = (weight / weight.sum(axis=1, keepdims=True))[..., None]
    centred = offset - (weight * offset).sum(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", weight * centred, centred))
    return np.maximum(spread, 0), axes


def _quadric(offset: Float64, weight: Float64, axes: Float64) -> tuple[Float64, Float64]:
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
        text = "points left out because they are behind the camera"
        warnings += counted(Notice("points-behind-camera", text), int((~before).sum()))
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

    def blend(shown: Bool) -> tuple[Float32, Float32]:
        members, begin = sort_into_bands(
            np.where(shown, first, np.int16(1)),
            np.where(shown, last, np.int16(0)),
            -(-rows // BAND_ROWS),
        )
        out = np.zeros((rows, columns, 3), np.float32)
        height = np.full((rows, columns), np.nan, np.float32)
        in_threads(
            _splat, len(begin) - 1, points, normals, bends, radii, pixels, reach_px, members, begin,
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
    covered = _covered(row[inside], column[inside], np.isfinite(height))
    if covered < _LEAST_COVERED:
        text = (
            f"the points cover {covered:.1%} of their outline: fit the normals to more neighbours, "
            "or choose larger pixels"
        )
        warnings.append(Notice("outline-not-covered", text))
    return Drawn(out, height, tuple(warnings))


def _covered(row: Intp, column: Intp, drawn: Bool) -> float:
    """Return the share of the pixels within the outline of the points that are drawn.

    The outline consists of cells of some points each; those at its rim do not count, because
    they are partly empty.
    """
    if not len(row):
        return 1.0
    area = float((np.ptp(row) + 1) * (np.ptp(column) + 1))
    size = max(math.ceil(math.sqrt(area * _POINTS_IN_CELL / len(row))), 1)
    rows, columns = -(-drawn.shape[0] // size), -(-drawn.shape[1] // size)
    cells = np.zeros((rows, columns), np.bool_)
    cells[row // size, column // size] = True
    inner = binary_erosion(cells, np.ones((3, 3), np.bool_))
    pixels = np.zeros((rows * size, columns * size), np.bool_)
    pixels[: drawn.shape[0], : drawn.shape[1]] = drawn
    share = pixels.reshape(rows, size, columns, size).mean(axis=(1, 3))
    return float(share[inner].mean()) if inner.any() else 1.0


def orient(points: Float64, normals: Float64, front: Bool) -> Float64:
    """Propagate the orientation of the points in front to all other points.

    A point takes its orientation from the previous point on the path from the front along which the
    normals change least (after Hoppe et al., 1992, who grow one tree from one point).

    Parameters
    ----------
    points
        ``(N, 3)``.
    normals
        ``(N, 3)`` unit vectors; of either sign for points that are not in front.
    front
        ``(N,)``, True for points whose sign is correct.

    Returns
    -------
    Double
        ``(N, 3)`` normals; points without a path from the front keep their normals.
    """
    count = min(_NEIGHBOURS, len(points))
    _, near = cKDTree(points).query(points, count)
    # Normals of a few digits may be longer than 1, and negative lengths of paths never end.
    bend = np.maximum(1 - np.abs(np.einsum("nki,ni->nk", normals[near], normals)), -_STEP) + _STEP
    begin = np.arange(len(points) + 1) * count
    graph = csr_array((bend.ravel(), near.ravel(), begin), (len(points), len(points)))
    length, before, _ = dijkstra(
        graph, directed=False, indices=np.flatnonzero(front), return_predecessors=True,
        min_only=True,
    )  # fmt: skip
    order = np.argsort(length, kind="stable")
    oriented = normals.copy()
    _carry(oriented, before.astype(np.int64), order[~front[order]])
    return oriented


@numba.njit(cache=True)
def _carry(normals: Float64, before: Int64, order: Int64) -> None:
    for i in order:
        j = before[i]
        if j >= 0:
            dot = 0.0
            for axis in range(3):
                dot += normals[i, axis] * normals[j, axis]
            if dot < 0:
                for axis in range(3):
                    normals[i, axis] = -normals[i, axis]


@numba.njit(**PART)
def _meet(
    dx: float, dy: float, ray_x: float, ray_y: float, nx: float, ny: float, nz: float
) -> tuple[float, float]:
    """Return how far below the disc's centre a line meets its plane, and the squared distance.

    ``dx`` and ``dy`` are the offset from the line to the centre at the centre's height.
    """
    # Normals point toward the viewer, the line points away.
    t = -(nx * dx + ny * dy) / max(nz - nx * ray_x - ny * ray_y, _GRAZING)
    x, y = t * ray_x - dx, t * ray_y - dy
    return t, x * x + y * y + t * t


@numba.njit(**PART)
def _bent(
    bend: Float64, x: float, y: float, z: float, nx: float, ny: float, nz: float
) -> tuple[float, float, float]:
    """Return the unit normal at an offset from a disc's centre."""
    bx = bend[0, 0] * x + bend[0, 1] * y + bend[0, 2] * z
    by = bend[1, 0] * x + bend[1, 1] * y + bend[1, 2] * z
    bz = bend[2, 0] * x + bend[2, 1] * y + bend[2, 2] * z
    scale = _MOST_BENT / max(math.sqrt(bx * bx + by * by + bz * bz), _MOST_BENT)
    mx, my, mz = nx + scale * bx, ny + scale * by, nz + scale * bz
    length = math.sqrt(mx * mx + my * my + mz * mz)
    return mx / length, my / length, mz / length


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _splat(
    first_band: int,
    last_band: int,
    points: Float64,
    point_normals: Float64,
    bends: Float64,
    radii: Float64,
    pixels: Float64,
    reach_px: Float64,
    members: Int32,
    begin: Int64,
    band_rows: int,
    x: Float64,
    y: Float64,
    rays: Float64,
    eye_z: float,
    normals: Float32,
    height: Float32,
) -> None:
    """Blend the discs of the nearest layer at each pixel into normals and heights.

    A layer consists of the discs within one disc radius behind the nearest disc. Weights decrease
    from the disc's centre to 0 at its rim. ``bends`` ``(N, 3, 3)`` times the offset from the centre
    is the change of the normal. Lines of sight are those of
    `processing.projection.rasterize_kernels.shade`.
    """
    rows, columns = height.shape
    bent = rays.shape[0] > 1
    for band in range(first_band, last_band):
        first = band * band_rows
        last = min(first + band_rows, rows) - 1
        nearest = np.full((band_rows, columns), -np.inf)
        total = np.zeros((band_rows, columns, 5))
        for blend in (False, True):
            for m in range(begin[band], begin[band + 1]):
                i = members[m]
                nx, ny, nz = point_normals[i, 0], point_normals[i, 1], point_normals[i, 2]
                below = eye_z - points[i, 2]
                reach2 = radii[i] ** 2
                top = max(math.ceil(pixels[i, 1] - reach_px[i]), first)
                bottom = min(math.floor(pixels[i, 1] + reach_px[i]), last)
                left = max(math.ceil(pixels[i, 0] - reach_px[i]), 0)
                right = min(math.floor(pixels[i, 0] + reach_px[i]), columns - 1)
                for r in range(top, bottom + 1):
                    for c in range(left, right + 1):
                        ray_x = rays[r, c, 0] if bent else rays[0, 0, 0]
                        ray_y = rays[r, c, 1] if bent else rays[0, 0, 1]
                        dx = points[i, 0] - x[c] - below * ray_x
                        dy = points[i, 1] - y[r] - below * ray_y
                        t, distance2 = _meet(dx, dy, ray_x, ray_y, nx, ny, nz)
                        if distance2 >= reach2:
                            continue
                        z = points[i, 2] - t
                        if not blend:
                            nearest[r - first, c] = max(nearest[r - first, c], z)
                        elif z >= nearest[r - first, c] - radii[i]:
                            w = (1 - distance2 / reach2) ** 3
                            mx, my, mz = _bent(
                                bends[i], t * ray_x - dx, t * ray_y - dy, -t, nx, ny, nz
                            )
                            total[r - first, c, 0] += w * mx
                            total[r - first, c, 1] += w * my
                            total[r - first, c, 2] += w * mz
                            total[r - first, c, 3] += w * z
                            total[r - first, c, 4] += w
        for r in range(first, last + 1):
            for c in range(columns):
                sum_x, sum_y, sum_z = total[r - first, c, :3]
                length = math.sqrt(sum_x * sum_x + sum_y * sum_y + sum_z * sum_z)
                if length > 0:
                    normals[r, c, 0] = sum_x / length
                    normals[r, c, 1] = sum_y / length
                    normals[r, c, 2] = sum_z / length
                    height[r, c] = total[r - first, c, 3] / total[r - first, c, 4]
