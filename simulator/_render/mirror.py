"""The mirror equation of a sphere: the point that mirrors a light, and the size of its image."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from simulator._scene.lens import Lens
from simulator._scene.scene import ChromeSphere

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_HALVINGS = 60
_STEP_PX = 0.01


def mirror_points(
    lens: Lens, sphere: ChromeSphere, lights: Array, *, near: bool
) -> tuple[Array, Flags]:
    """Find the points of a sphere that mirror lights into the camera (Alhazen's problem).

    The point is in the plane of eye, light and centre, and its normal bisects the angle between eye
    and light. Along the arc from the eye's side to the light's side, the difference of the two
    angles is monotonic, so bisection of the arc finds the point.

    Parameters
    ----------
    lens
        Lens of the camera; its eye may be at infinity.
    sphere
        The mirror.
    lights
        ``(N, 3)`` positions outside the sphere, or unit directions toward distant lights.
    near
        Whether ``lights`` are positions.

    Returns
    -------
    points_mm, visible
        ``(N, 3)`` and ``(N,)``; a point is not visible if the sphere itself hides it from camera or
        light.
    """
    middle = np.array(sphere.centre_mm)
    to_eye = lens.eye_to(middle)
    to_light = lights - middle if near else lights
    along = to_light @ to_eye
    side = to_light - along[:, None] * to_eye
    length = np.linalg.norm(side, axis=1, keepdims=True)
    side = side / np.where(length > 0, length, 1.0)
    low, high = np.zeros(len(lights)), np.arctan2(length[:, 0], along)
    for _ in range(_HALVINGS):
        half = (low + high) / 2
        normals = np.cos(half)[:, None] * to_eye + np.sin(half)[:, None] * side
        points = middle + sphere.radius_mm * normals
        leaving, arriving = lens.eye_to(points), toward(lights, points, near=near)
        too_far = _angle(leaving, normals) > _angle(arriving, normals)
        low, high = np.where(too_far, low, half), np.where(too_far, half, high)
    facing = np.minimum((arriving * normals).sum(axis=1), (leaving * normals).sum(axis=1))
    return points, facing > 0


def image_depth_mm(
    lens: Lens, sphere: ChromeSphere, points: Array, distance_mm: Array | float
) -> Array:
    """Return the depth of the virtual images of lights behind the points that mirror them.

    This is the tangential focus, ``1 / image = 1 / light + 2 / (R cos t)`` for the angle t of
    incidence; the sagittal focus is less than a tenth of the radius away for t up to 30 degrees.

    Parameters
    ----------
    lens, sphere
        Camera and mirror.
    points
        ``(N, 3)`` mirror points.
    distance_mm
        Distances of the lights from the points; infinity for distant lights.

    Returns
    -------
    Array
        ``(N,)`` depth below the camera.
    """
    leaving = lens.eye_to(points)
    normals = (points - np.array(sphere.centre_mm)) / sphere.radius_mm
    cosine = np.maximum((leaving * normals).sum(axis=1), 1e-6)
    behind = 1 / (1 / np.asarray(distance_mm) + 2 / (sphere.radius_mm * cosine))
    depth: Array = lens.camera_z_mm - points[:, 2] + behind * leaving[:, 2]
    return depth


def mm_per_pixel(
    lens: Lens,
    sphere: ChromeSphere,
    pixels: Array,
    frame: tuple[Array, Array, Array, Array],
    *,
    near: bool,
) -> Array:
    """Return the derivative of the mirrored ray's position on the lights, ``(n, 2, 2)``.

    The unit is mm per pixel, or for distant lights radians per pixel on the sphere of directions.
    The derivative is computed by central differences of the exact path from the pixel via the
    sphere to the plane of the LED's disc.
    """
    first, second, axes, targets = frame
    columns = []
    for shift in ((_STEP_PX, 0.0), (0.0, _STEP_PX)):
        ends = []
        for sign in (1, -1):
            end, direction = _mirror_ray(lens, sphere, pixels + sign * np.array(shift))
            if near:
                reach = ((targets - end) * axes).sum(axis=1) / (direction * axes).sum(axis=1)
                ends.append(end + reach[:, None] * direction)
            else:
                ends.append(direction)
        step = (ends[0] - ends[1]) / (2 * _STEP_PX)
        columns.append(np.stack([(step * first).sum(axis=1), (step * second).sum(axis=1)], axis=1))
    return np.stack(columns, axis=2)


def _mirror_ray(lens: Lens, sphere: ChromeSphere, pixels: Array) -> tuple[Array, Array]:
    """Return start and unit direction of the rays of pixels after their reflection."""
    origins, rays = lens.origins_and_rays(pixels[:, 0], pixels[:, 1])
    direction = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    offset = origins - np.array(sphere.centre_mm)
    b = (direction * offset).sum(axis=1)
    root = np.clip(b * b - ((offset**2).sum(axis=1) - sphere.radius_mm**2), 0.0, None)
    start = origins + (-b - np.sqrt(root))[:, None] * direction
    normal = (start - np.array(sphere.centre_mm)) / sphere.radius_mm
    return start, direction - 2 * (direction * normal).sum(axis=1, keepdims=True) * normal


def toward(lights: Array, points: Array, *, near: bool) -> Array:
    """Return unit directions from points to lights."""
    if not near:
        return lights
    way = lights - points
    direction: Array = way / np.linalg.norm(way, axis=1, keepdims=True)
    return direction


def _angle(a: Array, b: Array) -> Array:
    cross = np.linalg.norm(np.cross(a, b), axis=1)
    angle: Array = np.arctan2(cross, (a * b).sum(axis=1))
    return angle


def between(start: Array, way: Array, length: Array | float, sphere: ChromeSphere) -> Flags:
    """Return which line segments, given by start, unit direction and length, pass a sphere."""
    middle = np.array(sphere.centre_mm)
    t = np.clip(((middle - start) * way).sum(axis=1), 0.0, length)
    inside: Flags = np.linalg.norm(start + t[:, None] * way - middle, axis=1) < sphere.radius_mm
    return inside
