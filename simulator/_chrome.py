"""LEDs mirrored in chrome spheres: where their images lie, and how bright they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from simulator._optics import centre, pixel_rays, project
from simulator._scene import ChromeSphere, Scene

Array = npt.NDArray[np.float64]

_HALVINGS = 60
_STEP_PX = 0.01
_REACH_SIGMAS = 6.0


@dataclass(frozen=True, eq=False)
class Highlights:
    """The mirrored LEDs of a scene, NaN where a sphere does not show an LED to the camera.

    Parameters
    ----------
    pixels
        ``(S, N, 2)`` exact position (x, y) of LED n in sphere s.
    signal
        ``(S, N)`` radiance summed over the image, in pixels times the radiance of a white surface
        under irradiance 1.
    sigma_px
        ``(S, N)`` width of the image: the lens blur widened by the disc of the LED.
    """

    pixels: Array
    signal: Array
    sigma_px: Array


def find_highlights(scene: Scene) -> Highlights:
    """Solve the mirror point of every LED in every sphere.

    Parameters
    ----------
    scene
        The scene. Images of images (an LED seen in one sphere by way of another) are left out:
        they are hundreds of times weaker.

    Returns
    -------
    Highlights
        Exact to rounding; the signal to 1e-6 of itself.
    """
    positions = np.asarray(scene.lights.positions_mm)
    shape = (len(scene.spheres), len(positions))
    pixels, signal, sigma = np.full((*shape, 2), np.nan), np.full(shape, np.nan), np.zeros(shape)
    eye = centre(scene.camera)
    for i, sphere in enumerate(scene.spheres):
        points, visible = mirror_points(eye, sphere, positions)
        for j, other in enumerate(scene.spheres):
            if j != i:
                visible &= ~_between(points, np.broadcast_to(eye, points.shape), other)
                visible &= ~_between(points, positions, other)
        leaving = points - positions
        cosine = (leaving * np.asarray(scene.lights.axes)).sum(axis=1)
        cosine /= np.linalg.norm(leaving, axis=1)
        visible &= cosine > 1e-3
        pixels[i] = project(scene.camera, points)
        stretch = _disc_per_pixel(scene, sphere, pixels[i])
        # The disc's radiance is I0 cos^(mu-1) / (pi a^2) and its image covers pi a^2 / |det|
        # pixels: the signal does not depend on its radius a.
        per_disc = np.abs(np.linalg.det(stretch))
        mu = np.asarray(scene.lights.mu)
        radiance = math.pi * scene.axial_intensity * np.where(visible, cosine, 1.0) ** (mu - 1)
        signal[i] = np.where(visible, sphere.reflectance * radiance / per_disc, np.nan)
        # A uniform disc has a variance of a^2 / 4 along each axis.
        spread = (np.linalg.inv(stretch) ** 2).sum(axis=(1, 2)) / 2
        sigma[i] = np.sqrt(scene.psf_sigma_px**2 + scene.led_radius_mm**2 / 4 * spread)
        pixels[i][~visible] = np.nan
    return Highlights(pixels, signal, np.where(np.isnan(signal), np.nan, sigma))


def mirror_points(
    eye_mm: Array, sphere: ChromeSphere, positions_mm: Array
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Find the points of a sphere that mirror lights into the eye (Alhazen's problem).

    The point lies in the plane of eye, light and centre, where its normal halves the angle
    between the two. Along the arc from the eye's side to the light's side the difference of the
    two angles grows, so halving the arc finds the point.

    Parameters
    ----------
    eye_mm
        Centre of projection.
    sphere
        The mirror.
    positions_mm
        ``(N, 3)`` lights outside the sphere.

    Returns
    -------
    points_mm, visible
        ``(N, 3)`` and ``(N,)``: not visible where the sphere stands in its own way.
    """
    middle = np.array(sphere.centre_mm)
    to_eye = eye_mm - middle
    to_eye = to_eye / np.linalg.norm(to_eye)
    to_light = positions_mm - middle
    along = to_light @ to_eye
    side = to_light - along[:, None] * to_eye
    length = np.linalg.norm(side, axis=1, keepdims=True)
    side = side / np.where(length > 0, length, 1.0)
    low, high = np.zeros(len(positions_mm)), np.arctan2(length[:, 0], along)
    for _ in range(_HALVINGS):
        half = (low + high) / 2
        normals = np.cos(half)[:, None] * to_eye + np.sin(half)[:, None] * side
        points = middle + sphere.radius_mm * normals
        too_far = _angle(eye_mm - points, normals) > _angle(positions_mm - points, normals)
        low, high = np.where(too_far, low, half), np.where(too_far, half, high)
    visible = ((positions_mm - points) * normals).sum(axis=1) > 0
    visible &= ((eye_mm - points) * normals).sum(axis=1) > 0
    return points, visible


def splat(
    plane: npt.NDArray[np.float32], x_px: float, y_px: float, sigma: float, sum_: float
) -> None:
    """Add a Gaussian spot, integrated over each pixel, whose pixels add up to ``sum_``."""
    reach = _REACH_SIGMAS * sigma + 1
    columns = np.arange(max(0, math.ceil(x_px - reach)), min(plane.shape[1], int(x_px + reach) + 1))
    rows = np.arange(max(0, math.ceil(y_px - reach)), min(plane.shape[0], int(y_px + reach) + 1))
    if columns.size and rows.size:
        spot = np.outer(_share(rows - y_px, sigma), _share(columns - x_px, sigma))
        plane[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += sum_ * spot


def _share(offset: Array, sigma: float) -> Array:
    """Return the part of a Gaussian that falls on pixels at these offsets from its middle."""
    scale = sigma * math.sqrt(2)
    share = [(math.erf((v + 0.5) / scale) - math.erf((v - 0.5) / scale)) / 2 for v in offset]
    return np.array(share)


def _angle(a: Array, b: Array) -> Array:
    cross = np.linalg.norm(np.cross(a, b), axis=1)
    angle: Array = np.arctan2(cross, (a * b).sum(axis=1))
    return angle


def _between(a: Array, b: Array, sphere: ChromeSphere) -> npt.NDArray[np.bool_]:
    """Return which of the straight ways from a to b pass through a sphere."""
    way = b - a
    t = ((np.array(sphere.centre_mm) - a) * way).sum(axis=1) / (way**2).sum(axis=1)
    nearest = a + np.clip(t, 0.0, 1.0)[:, None] * way
    inside: npt.NDArray[np.bool_] = (
        np.linalg.norm(nearest - np.array(sphere.centre_mm), axis=1) < sphere.radius_mm
    )
    return inside


def _disc_per_pixel(scene: Scene, sphere: ChromeSphere, pixels: Array) -> Array:
    """Return how the mirrored ray moves over each LED's disc, ``(N, 2, 2)`` mm per pixel.

    Central differences of the exact path from the pixel over the sphere to the disc's plane.
    """
    axes = np.asarray(scene.lights.axes)
    positions = np.asarray(scene.lights.positions_mm)
    helper = np.where(np.abs(axes[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(axes, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(axes, first)
    columns = []
    for shift in ((_STEP_PX, 0.0), (0.0, _STEP_PX)):
        ends = []
        for sign in (1, -1):
            at = pixels + sign * np.array(shift)
            start, direction = _mirror_ray(scene, sphere, at)
            reach = ((positions - start) * axes).sum(axis=1) / (direction * axes).sum(axis=1)
            ends.append(start + reach[:, None] * direction - positions)
        step = (ends[0] - ends[1]) / (2 * _STEP_PX)
        columns.append(np.stack([(step * first).sum(axis=1), (step * second).sum(axis=1)], axis=1))
    return np.stack(columns, axis=2)


def _mirror_ray(scene: Scene, sphere: ChromeSphere, pixels: Array) -> tuple[Array, Array]:
    """Return start and direction of the rays of pixels after the sphere."""
    eye = centre(scene.camera)
    direction = pixel_rays(scene.camera, pixels[:, 0], pixels[:, 1])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    offset = eye - np.array(sphere.centre_mm)
    b = direction @ offset
    root = np.clip(b * b - (offset @ offset - sphere.radius_mm**2), 0.0, None)
    start = eye + (-b - np.sqrt(root))[:, None] * direction
    normal = (start - np.array(sphere.centre_mm)) / sphere.radius_mm
    mirrored = direction - 2 * (direction * normal).sum(axis=1, keepdims=True) * normal
    return start, mirrored
