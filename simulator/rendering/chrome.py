"""LEDs mirrored in chrome spheres: positions, brightness and width of the highlights."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from rig import in_threads, short_repr
from rig.arrays import Bool, Float32, Float64
from simulator.rendering.shadow import Occluders
from simulator.scene.lens import Lens, directions_across
from simulator.scene.scene import ChromeSphere, Scene

_MOST_RINGS = 16
_REACH_SIGMAS = 6.0
# Cosine to its axis below which an LED counts as seen from behind.
_GRAZING = 1e-3
# Largest distance of the ray of a highlight's pixel from its mirror point, in radii of the sphere.
_SAME_POINT = 1e-6
_HALVINGS = 60
_STEP_PX = 0.01


@dataclass(frozen=True, eq=False)
class MirroredLights:
    """The mirrored lights of a scene.

    Parameters
    ----------
    pixels
        ``(S, N, 2)`` exact position (x, y) of the centre of light n in sphere s, NaN if the camera
        does not see the light in this sphere.
    signal
        ``(S, N)`` radiance summed over the image, in pixels times the radiance of a white surface
        under irradiance 1; NaN if ``pixels`` is NaN. Vignetting is not included.
    spots
        ``(S, N, K, 2)`` positions of K points that are spread uniformly over each LED's disc.
    shares
        ``(S, N, K)`` contribution of each point to the signal, 0 if it is not seen.
    sigma_px
        Blur of a spot: that of the lens, or more if the discs are too large for K spots.
    circle_px
        ``(S, N)`` diameter of the circle of confusion of the mirrored light, 0 without defocus.
    """

    pixels: Float64
    signal: Float64
    spots: Float64
    shares: Float64
    sigma_px: float
    circle_px: Float64

    __repr__ = short_repr


def find_mirrored_lights(scene: Scene, occluders: Occluders | None = None) -> MirroredLights:
    """Compute the mirror points of every light, and of points on every LED's disc, in every sphere.

    Parameters
    ----------
    scene
        Scene to search. Reflections of reflections (an LED that one sphere shows via another) are
        omitted: they are hundreds of times weaker. Distant lights are points.
    occluders
        Objects that may be between a light and a sphere; without them, only the other spheres
        block the light. Clutter always hides spheres from the camera.

    Returns
    -------
    MirroredLights
        Positions to rounding error; signals to a relative error of 1e-6.

    Examples
    --------
    >>> from simulator import scene_named
    >>> from simulator.rendering import find_mirrored_lights
    >>> scene = scene_named("spheres", width=64, height=52, leds=3)
    >>> find_mirrored_lights(scene).pixels.shape  # spheres, lights, x and y
    (4, 3, 2)
    """
    sigma, middle = scene.lens.blur_px, np.zeros((1, 2))
    centres, shares, px_per_mm, depth = _mirrored(scene, middle, occluders)
    spots, total = centres, shares
    if scene.lights.near and px_per_mm.size:
        radius_px = scene.led_radius_mm * float(px_per_mm.max())
        rings = min(max(math.ceil(radius_px / sigma), 1), _MOST_RINGS)
        sigma = max(sigma, radius_px / rings)
        spots, total, _, _ = _mirrored(scene, scene.led_radius_mm * _disc(rings), occluders)
    seen = shares[..., 0] > 0
    return MirroredLights(
        pixels=np.where(seen[..., None], centres[:, :, 0], np.nan),
        signal=np.where(seen, total.sum(axis=2), np.nan),
        spots=spots,
        shares=total,
        sigma_px=sigma,
        circle_px=scene.lens.circle_px(depth[..., 0]),
    )


def draw_mirrored_lights(
    scene: Scene, mirrored: MirroredLights, planes: Float32, *, top: int = 0
) -> None:
    """Add the mirrored lights to the images, in place.

    Parameters
    ----------
    scene
        Spheres, lights and lens. Each pixel of a Bayer mosaic uses the intensity of its channel.
    mirrored
        Mirrored lights of this scene.
    planes
        ``(N, H, W)`` radiance under each light, before vignetting.
    top
        Row of the image in which ``planes`` begin.
    """
    gains = np.ones((len(planes), 2, 2))
    y, x = np.mgrid[:2, :2]
    channel = scene.lens.channel(x, y)
    if channel is not None:
        gains = np.asarray(scene.lights.intensities)[:, channel] / scene.irradiance[:, None, None]
    for spots, shares, circles in zip(
        mirrored.spots, mirrored.shares, mirrored.circle_px, strict=True
    ):
        sigma, radius = mirrored.sigma_px, float(circles.max(initial=0.0)) / 2
        if radius:
            # A disc of light, like that of an LED, around each spot.
            rings = min(max(math.ceil(radius / sigma), 1), _MOST_RINGS)
            sigma = max(sigma, radius / rings)
            disc = circles[:, None, None, None] / 2 * _disc(rings)
            spots = (spots[:, :, None] + disc).reshape(len(spots), -1, 2)
            shares = np.repeat(shares / disc.shape[2], disc.shape[2], axis=1)
        in_threads(_draw, len(planes), planes, spots, shares, gains, sigma, top)


def _mirrored(
    scene: Scene, disc_mm: Float64, occluders: Occluders | None
) -> tuple[Float64, Float64, Float64, Float64]:
    """Mirror points of every LED's disc.

    Return pixels, shares of the signal, pixels per mm, and the depth of the virtual image.

    ``disc_mm`` (K, 2) are positions on the disc. The results are (S, N, K, 2) and three (S, N, K);
    for a point that is not seen they are NaN, 0, 0, and the depth of the mirror point.
    """
    lens, lights, near, samples = scene.lens, scene.lights, scene.lights.near, len(disc_mm)
    axes = np.repeat(np.asarray(lights.axes), samples, axis=0)
    first, second = directions_across(axes)
    places = np.asarray(lights.positions_mm if near else lights.directions)
    targets = np.repeat(places, samples, axis=0)
    power, mu = scene.irradiance, np.repeat(np.asarray(lights.mu), samples)
    if near:
        u, v = np.tile(disc_mm, (len(lights), 1)).T
        targets = targets + u[:, None] * first + v[:, None] * second
        power = scene.axial_intensity
    power = np.repeat(power, samples)
    count = (len(scene.spheres), len(lights) * samples)
    pixels, shares, scale = np.full((*count, 2), np.nan), np.zeros(count), np.zeros(count)
    depths = np.zeros(count)
    for i, sphere in enumerate(scene.spheres):
        points, visible = mirror_points(lens, sphere, targets, near=near)
        place = lens.project(points)
        origins, rays = lens.origins_and_rays(place[:, 0], place[:, 1])
        depth = lens.camera_z_mm - points[:, 2:]
        miss = np.linalg.norm(origins + depth * rays - points, axis=1)
        visible &= miss < _SAME_POINT * sphere.radius_mm
        arriving = toward(targets, points, near=near)
        distance = np.linalg.norm(targets - points, axis=1) if near else math.inf
        cosine = -(arriving * axes).sum(axis=1) if near else np.ones(len(points))
        depths[i] = image_depth_mm(lens, sphere, points, distance)
        visible &= cosine > _GRAZING
        for j, other in enumerate(scene.spheres):
            if j != i:
                visible &= ~between(points, lens.eye_to(points), math.inf, other)
                visible &= ~between(points, arriving, distance, other)
        visible &= ~_behind_clutter(scene, points)
        if occluders is not None:
            visible &= ~_in_shadow(occluders, sphere, points, places, near=near)
        pick = np.flatnonzero(visible)
        frame = (first[pick], second[pick], axes[pick], targets[pick])
        stretch = mm_per_pixel(lens, sphere, place[pick], frame, near=near)
        # An LED's radiance is I0 cos^(mu-1) / disc area, and its image covers disc area / |det|
        # pixels: the signal does not depend on the area. The same holds for a distant light on the
        # sphere of directions.
        radiance = math.pi * power[pick] * cosine[pick] ** (mu[pick] - 1 if near else 0.0)
        per_pixel = np.abs(np.linalg.det(stretch)) * samples
        pixels[i, pick] = place[pick]
        shares[i, pick] = sphere.reflectance * radiance / per_pixel
        scale[i, pick] = 1 / np.linalg.norm(stretch, -2, axis=(1, 2))
    shape = (len(scene.spheres), len(lights), samples)
    depths = depths.reshape(shape)
    return pixels.reshape(*shape, 2), shares.reshape(shape), scale.reshape(shape), depths


def _behind_clutter(scene: Scene, points: Float64) -> Bool:
    """Return which points of a sphere clutter hides from the camera."""
    near = scene.lens.camera is not None
    eye = np.array([[[0.0, 0.0, scene.lens.camera_z_mm if near else 1.0]]])
    even, solid = np.ones((1, len(points)), np.float32), np.zeros(len(points), np.bool_)
    objects = Occluders.of(scene.clutter_table, None)
    hidden: Bool = objects.occlude(even, points, points, solid, eye, near)[0]
    return hidden


def _disc(rings: int) -> Float64:
    """Return points spread uniformly over the unit disc, ``(K, 2)``, on rings of equal area.

    Their mean and variance are those of the disc for any number of rings.
    """
    points = []
    for ring in range(rings):
        radius = math.sqrt((ring + 0.5) / rings)
        # All rings have the same number of points, so all points have the same weight.
        angle = (np.arange(6 * rings) + 0.5 * (ring % 2)) * (2 * math.pi / (6 * rings))
        points.append(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(points)


def _in_shadow(
    occluders: Occluders, sphere: ChromeSphere, points: Float64, lights: Float64, *, near: bool
) -> Bool:
    """Return which points receive no light from the centre of their LED.

    ``points`` has the same number of points for each LED.
    """
    shadow = np.zeros((len(lights), len(points) // len(lights)), np.bool_)
    solid = np.ones(shadow.shape[1], np.bool_)
    for light, place, part in zip(lights, points.reshape(*shadow.shape, 3), shadow, strict=True):
        normals = (place - np.array(sphere.centre_mm)) / sphere.radius_mm
        even = np.ones((1, len(place)), np.float32)
        part[:] = occluders.occlude(even, place, normals, solid, light[None, None], near)[0]
    return shadow.ravel()


@numba.njit(nogil=True, cache=True)
def _draw(
    first: int,
    last: int,
    planes: Float32,
    spots: Float64,
    shares: Float64,
    gains: Float64,
    sigma: float,
    top: int,
) -> None:
    """Add Gaussian spots (N, K, 2) with shares (N, K), integrated over each pixel, to planes."""
    reach = _REACH_SIGMAS * sigma + 1.0
    scale = sigma * math.sqrt(2.0)
    rows, columns = planes.shape[1:]
    for n in range(first, last):
        for k in range(spots.shape[1]):
            x, y, share = spots[n, k, 0], spots[n, k, 1], shares[n, k]
            if not (share > 0.0 and -reach < x < columns + reach):
                continue
            if not top - reach < y < top + rows + reach:
                continue
            left, right = max(0, math.ceil(x - reach)), min(columns, int(x + reach) + 1)
            for r in range(max(top, math.ceil(y - reach)), min(top + rows, int(y + reach) + 1)):
                upper, lower = math.erf((r - y + 0.5) / scale), math.erf((r - y - 0.5) / scale)
                for c in range(left, right):
                    across = math.erf((c - x + 0.5) / scale) - math.erf((c - x - 0.5) / scale)
                    spot = across * (upper - lower) / 4.0
                    planes[n, r - top, c] += share * spot * gains[n, r % 2, c % 2]


def mirror_points(
    lens: Lens, sphere: ChromeSphere, lights: Float64, *, near: bool
) -> tuple[Float64, Bool]:
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
    lens: Lens, sphere: ChromeSphere, points: Float64, distance_mm: Float64 | float
) -> Float64:
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
    return np.asarray(lens.camera_z_mm - points[:, 2] + behind * leaving[:, 2])


def mm_per_pixel(
    lens: Lens,
    sphere: ChromeSphere,
    pixels: Float64,
    frame: tuple[Float64, Float64, Float64, Float64],
    *,
    near: bool,
) -> Float64:
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


def _mirror_ray(lens: Lens, sphere: ChromeSphere, pixels: Float64) -> tuple[Float64, Float64]:
    """Return start and unit direction of the rays of pixels after their reflection."""
    origins, rays = lens.origins_and_rays(pixels[:, 0], pixels[:, 1])
    direction = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    offset = origins - np.array(sphere.centre_mm)
    b = (direction * offset).sum(axis=1)
    root = np.clip(b * b - ((offset**2).sum(axis=1) - sphere.radius_mm**2), 0.0, None)
    start = origins + (-b - np.sqrt(root))[:, None] * direction
    normal = (start - np.array(sphere.centre_mm)) / sphere.radius_mm
    return start, direction - 2 * (direction * normal).sum(axis=1, keepdims=True) * normal


def toward(lights: Float64, points: Float64, *, near: bool) -> Float64:
    """Return unit directions from points to lights."""
    if not near:
        return lights
    way = lights - points
    return np.asarray(way / np.linalg.norm(way, axis=1, keepdims=True))


def _angle(a: Float64, b: Float64) -> Float64:
    cross = np.linalg.norm(np.cross(a, b), axis=1)
    return np.asarray(np.arctan2(cross, (a * b).sum(axis=1)))


def between(start: Float64, way: Float64, length: Float64 | float, sphere: ChromeSphere) -> Bool:
    """Return which line segments, given by start, unit direction and length, pass a sphere."""
    middle = np.array(sphere.centre_mm)
    t = np.clip(((middle - start) * way).sum(axis=1), 0.0, length)
    inside: Bool = np.linalg.norm(start + t[:, None] * way - middle, axis=1) < sphere.radius_mm
    return inside
