"""Slopes and curvature of a surface from its normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError
from acquisition.files import rows_in_bands
from calibration import EstimateError
from processing.maps.local_planes import fit_planes
from processing.maps.normal_map import NormalMap, check_normal_map
from processing.surface.scale import surface_scale
from rig.arrays import Bool, Float32, Float64

# Cosine of the angle to the line of sight, within 6 degrees of edge-on.
_LEAST_FACING = 0.1
_ROWS = 256
# Steeper normals (beyond 84 degrees) have no slopes that could be used.
_LEAST_NZ = 0.1
_MOST_SCALE = 100.0


class _Planes(NamedTuple):
    """Planes of n_x and n_y around each pixel of a band, each ``(2, H, W)`` float64."""

    value: Float64
    right: Float64
    up: Float64
    known: Bool


@dataclass(frozen=True, eq=False)
class Curvature:
    """Slopes and curvatures of a surface, NaN where they are not determined.

    Curvatures are positive where the surface is convex toward the camera: 1/R and 1/R^2 on a ball
    of radius R, -1/R and 1/R^2 in a bowl.

    Parameters
    ----------
    gradient
        ``(H, W, 2)`` float32 slopes dz/dx and dz/dy, without a unit.
    mean
        ``(H, W)`` float32 mean curvature, (k1 + k2) / 2, in 1 / ``unit``.
    gaussian
        ``(H, W)`` float32 Gaussian curvature, k1 k2, in 1 / ``unit^2``.
    direction_deg
        ``(H, W)`` float32 direction of the largest curvature k1 in the image, counter-clockwise
        from X, 0 to 180. Where both curvatures are equal it is arbitrary.
    mask
        ``(H, W)`` bool, the pixels with a curvature.
    unit
        ``mm``, or ``px`` if the scale is not known.
    pixel_size
        Distance between neighbouring pixels in `unit`; with a camera, at the working distance.
    scale_px
        Standard deviation of the weights of the fit.
    """

    gradient: Float32
    mean: Float32
    gaussian: Float32
    direction_deg: Float32
    mask: Bool
    unit: Literal["mm", "px"]
    pixel_size: float
    scale_px: float

    def __repr__(self) -> str:
        shape = f"{self.mean.dtype}{list(self.mean.shape)}"
        return f"Curvature({shape} in 1/{self.unit}, scale {self.scale_px:g} px)"

    @property
    def principal(self) -> tuple[Float32, Float32]:
        """The largest and the smallest curvature k1, k2, each ``(H, W)``, in 1 / `unit`."""
        root = np.sqrt(np.maximum(self.mean * self.mean - self.gaussian, 0))
        return self.mean + root, self.mean - root


def curvature(
    normal_map: NormalMap,
    *,
    camera: CameraModel | None = None,
    pixel_mm: float | None = None,
    depth_mm: npt.ArrayLike | None = None,
    scale_px: float = 2.0,
) -> Curvature:
    """Return slopes, mean and Gaussian curvature from a normal map.

    In the coordinates X and Y of the surface, the shape operator is the Jacobian J of (n_x, n_y):
    the mean curvature is half of its trace, the divergence of the normals, and the Gaussian
    curvature its determinant (compare do Carmo, Differential Geometry of Curves and Surfaces,
    section 3.3). Around each pixel a plane is fitted to n_x and n_y with Gaussian weights inside
    the mask (compare Farnebäck, 2002: normalised convolution). On a sphere this is exact at every
    scale, up to the border. Independent errors of the normals of sigma (in radians, along each
    direction) give the mean curvature errors of ``sigma / (7.1 scale^2)`` per pixel where it faces
    the camera, and waves of wavelength L are damped by ``exp(-19.7 (scale / L)^2)``. Steps between
    surfaces look like sharp edges: leave them out of the mask.

    Parameters
    ----------
    normal_map
        The normals; nothing outside its mask is used.
    camera
        A perspective camera of the same image size; without a camera the view is orthographic.
    pixel_mm
        Distance between neighbouring pixels on the object, if no camera has a working distance.
        Without any scale the unit is the pixel.
    depth_mm
        ``(H, W)`` depth of the surface, for a camera with a working distance, `HeightMap.depth`;
        without it, all points are in the working plane, and the curvatures are those of the surface
        times depth / working distance.
    scale_px
        Standard deviation of the weights in pixels, 0.3 to 100; at 0.3 they are central
        differences.

    Returns
    -------
    Curvature
        NaN outside the mask, within 6 degrees of edge-on, and where the neighbours inside the mask
        are on a line.

    Raises
    ------
    DataError
        If the camera or the depth has another size, a scale is not positive, or both a pixel size
        and a working distance are given.
    EstimateError
        If no pixel has a curvature.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.curvatures import curvature
    >>> y, x = np.mgrid[20:-21:-1, -20:21] / 50  # Y is up; a ball with a radius of 50 px
    >>> ball = NormalMap.from_vectors(np.dstack([x, y, np.sqrt(1 - x**2 - y**2)]))
    >>> found = curvature(ball, pixel_mm=0.1)
    >>> found
    Curvature(float32[41, 41] in 1/mm, scale 2 px)
    >>> f"{found.mean[0, 0]:.4f}, {found.gaussian[20, 20]:.4f}"
    '0.2000, 0.0400'
    """
    check_normal_map("normal_map", normal_map)
    if not 0.3 <= scale_px <= _MOST_SCALE:
        raise DataError(f"a scale of {scale_px} pixels is not within 0.3 to {_MOST_SCALE:g}")
    unit, pixel_size = surface_scale(camera, pixel_mm)
    if camera is not None and camera.size != normal_map.size:
        raise DataError(
            f"a camera of {camera.width} x {camera.height} pixels does not fit a normal map of "
            f"{normal_map.size[1]} x {normal_map.size[0]}: crop or replace the camera"
        )
    if depth_mm is not None and (camera is None or camera.working_distance_mm is None):
        raise DataError("depths require a camera with a working distance")
    depth = None if camera is None else _depth(depth_mm, normal_map, camera, pixel_size)
    result = Curvature(
        gradient=np.full((*normal_map.size, 2), np.nan, np.float32),
        mean=np.full(normal_map.size, np.nan, np.float32),
        gaussian=np.full(normal_map.size, np.nan, np.float32),
        direction_deg=np.full(normal_map.size, np.nan, np.float32),
        mask=np.zeros(normal_map.size, bool),
        unit=unit,
        pixel_size=pixel_size,
        scale_px=scale_px,
    )
    usable = normal_map.mask & (normal_map.normals[..., 2] > _LEAST_NZ)
    fitted = [fit_planes(normal_map.normals[..., i], usable, scale_px) for i in range(2)]
    for rows in rows_in_bands(normal_map.size[0], 1, _ROWS):
        value, right, up = (
            np.stack([part[rows] for part in parts]).astype(np.float64)
            for parts in zip(*(planes[:3] for planes in fitted), strict=True)
        )
        planes = _Planes(value, right, up, fitted[0].known[rows])
        if depth is None or camera is None:
            steps = pixel_size * np.eye(2)[..., None, None]
        else:
            steps = _surface_steps(camera, _unit(planes), depth[rows], rows.start)
        _write(result, rows, planes, steps)
    if not result.mask.any():
        height, columns = normal_map.size
        raise EstimateError(
            f"no pixel of the normal map of {columns} x {height} has a curvature: it requires "
            "neighbours that are not on a line and face the camera; check the mask"
        )
    return result


def _depth(
    depth_mm: npt.ArrayLike | None, normal_map: NormalMap, camera: CameraModel, pixel_size: float
) -> Float64:
    if depth_mm is None:
        return np.full(normal_map.size, pixel_size * camera.focal_px)
    depth = np.asarray(depth_mm, np.float64)
    if depth.shape != normal_map.size or not (depth[np.isfinite(depth)] > 0).all():
        raise DataError(
            f"depths of shape {depth.shape} must be positive and have the size of the normal map, "
            f"{normal_map.size}"
        )
    return depth


def _unit(planes: _Planes) -> Float64:
    x, y = planes.value
    return np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, _LEAST_NZ**2))])


def _write(result: Curvature, rows: slice, planes: _Planes, steps: Float64) -> None:
    """Write the rows of the result: ``steps`` are X and Y by pixels, see `_surface_steps`."""
    x, y, z = _unit(planes)
    (x_right, x_up), (y_right, y_up) = steps
    area = x_right * y_up - x_up * y_right
    # Derivatives of n_x and n_y by X and Y.
    a, c = ((r * y_up - u * y_right) / area for r, u in zip(planes.right, planes.up, strict=True))
    b, d = ((u * x_right - r * x_up) / area for r, u in zip(planes.right, planes.up, strict=True))
    known = planes.known & np.isfinite(a + b + c + d)
    slopes = -x / z, -y / z
    maps = {
        "mean": (a + d) / 2,
        "gaussian": a * d - b * c,
        "direction_deg": _direction_deg(slopes, (a, b, c, d)),
    }
    for name, values in maps.items():
        getattr(result, name)[rows] = np.where(known, values, np.nan)
    result.gradient[rows] = np.where(known[..., None], np.stack(slopes, axis=-1), np.nan)
    result.mask[rows] = known


def _direction_deg(slopes: tuple[Float64, Float64], jacobian: tuple[Float64, ...]) -> Float64:
    """Return the direction of the largest curvature in X and Y.

    The Jacobian of noisy normals is no shape operator: the second fundamental form is made
    symmetric.
    """
    p, q = slopes
    a, b, c, d = jacobian
    e, f, g = 1 + p * p, p * q, 1 + q * q
    xx, yy = e * a + f * c, f * b + g * d
    xy = (e * b + f * d + f * a + g * c) / 2
    determinant = e * g - f * f
    s00, s01 = (g * xx - f * xy) / determinant, (g * xy - f * yy) / determinant
    s10, s11 = (e * xy - f * xx) / determinant, (e * yy - f * xy) / determinant
    half = (s00 - s11) / 2
    root = np.sqrt(np.maximum(half * half + s01 * s10, 0))
    # The columns of S - k2 are along the direction of k1; the longer one has less noise.
    first = half >= 0
    along = np.where(first, half + root, s01), np.where(first, s10, root - half)
    return np.asarray(np.degrees(np.arctan2(along[1], along[0])) % 180.0)


def _surface_steps(
    camera: CameraModel, normals: Float64, depth: Float64, first_row: int
) -> Float64:
    """Return the change of X and Y of the surface from pixel to pixel.

    A surface point is ``centre + d r`` with the ray r. Its tangents are at right angles to the
    normal n, so the depth changes by ``-d (n . dr) / (n . r)``.

    Parameters
    ----------
    camera
        The camera.
    normals
        ``(3, R, W)`` unit normals of some rows.
    depth
        ``(R, W)`` depth d along the optical axis.
    first_row
        Row of the first of them in the image.

    Returns
    -------
    NDArray
        ``(2, 2, R, W)``: X and Y by one pixel to the right and one up, in the unit of the depth.
        NaN where the surface is seen from behind or edge-on.
    """
    rows, columns = depth.shape
    x, y = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows) + float(first_row))

    def rays(right: float, up: float) -> Float64:
        return np.moveaxis(camera.rays(np.stack([x + right, y - up], axis=-1)), -1, 0)

    ray = rays(0, 0)
    facing = -np.sum(normals * ray, axis=0)
    facing = np.where(facing > _LEAST_FACING * np.linalg.norm(ray, axis=0), facing, np.nan)
    steps = np.zeros((2, 2, rows, columns))
    for i, (right, up) in enumerate(((0.5, 0.0), (0.0, 0.5))):
        change = rays(right, up) - rays(-right, -up)
        deeper = depth * np.sum(normals * change, axis=0) / facing
        steps[:, i] = deeper * ray[:2] + depth * change[:2]
    return steps
