"""From a scene to one plane of radiance per LED, with its truth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from simulator._chrome import find_highlights, splat
from simulator._optics import pixel_rays, project
from simulator._scene import ChromeSphere, Scene
from simulator._shade import shade
from simulator._trace import trace_spheres, trace_surface
from simulator._truth import Truth

Array = npt.NDArray[np.float64]
Values = npt.NDArray[np.float32]

_SUBPIXELS = 4  # along each axis, wherever a sphere touches a pixel


@dataclass(frozen=True, eq=False)
class Rendering:
    """The images of a scene without noise.

    Parameters
    ----------
    planes
        ``(N, H, W)`` electrons per microsecond that each LED gives alone.
    ambient
        ``(H, W)`` electrons per microsecond from the room, in every frame.
    truth
        What the scene is.
    """

    planes: Values
    ambient: Values
    truth: Truth

    def plane(self, led: int | None) -> Values:
        """Return what one LED gives alone, or for None what the room gives.

        Parameters
        ----------
        led
            Index of the LED.

        Returns
        -------
        Values
            ``(H, W)`` electrons per microsecond, the rendering's own memory.

        Raises
        ------
        DataError
            If the scene has no such LED.
        """
        if led is None:
            return self.ambient
        if not 0 <= led < len(self.planes):
            raise DataError(f"LED {led} is not in the scene: it has {len(self.planes)}")
        alone: Values = self.planes[led]
        return alone


def render(scene: Scene) -> Rendering:
    """Draw a scene under each of its LEDs.

    Object and board are Lambertian, sampled at the pixel's centre; pixels that a sphere touches
    are the mean of 4 x 4 samples, and the mirrored LEDs are added as spots of exact place and
    energy. Not drawn: cast shadows and interreflections of the object, light that the spheres
    throw on the board.

    Parameters
    ----------
    scene
        The scene.

    Returns
    -------
    Rendering
        Planes, ambient and truth.

    Raises
    ------
    DataError
        If the object may hide parts of itself from the camera.
    """
    height, width = scene.camera.size
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    rays = pixel_rays(scene.camera, x, y)
    hits = trace_surface(scene, rays)
    albedo = scene.albedo(hits.points_mm[..., 0], hits.points_mm[..., 1], hits.on_object)
    planes = shade(
        scene, hits.points_mm.reshape(-1, 3), hits.normals.reshape(-1, 3), albedo.ravel()
    ).reshape(-1, height, width)
    ambient = (albedo * scene.ambient).astype(np.float32)

    owner = np.full((height, width), -1)
    for sphere in scene.spheres:
        box = _box(scene, sphere)
        owner[box] = trace_spheres(scene, rays[box].reshape(-1, 3)).sphere.reshape(owner[box].shape)
    _draw_spheres(scene, planes, ambient)
    highlights = find_highlights(scene)
    for spots, sums, sigmas in zip(
        highlights.pixels, highlights.signal, highlights.sigma_px, strict=True
    ):
        for plane, spot, sum_, sigma in zip(planes, spots, sums, sigmas, strict=True):
            if math.isfinite(sum_):
                splat(plane, spot[0], spot[1], sigma, sum_)

    planes *= np.float32(scene.electrons_per_us)
    ambient *= np.float32(scene.electrons_per_us)
    table = scene.sphere_table
    mask = hits.on_object & (owner < 0)
    truth = Truth(
        normals=np.where(mask[..., None], hits.normals, 0.0).astype(np.float32),
        height_mm=np.where(mask, hits.points_mm[..., 2], np.nan),
        albedo=np.where(mask, albedo, 0.0).astype(np.float32),
        mask=mask,
        sphere_masks=owner == np.arange(len(table))[:, None, None],
        sphere_centres_mm=table[:, :3],
        sphere_radii_mm=table[:, 3],
        highlights_px=highlights.pixels,
        lights=scene.lights,
        camera=scene.camera,
        noise=scene.noise,
        electrons_per_us=scene.electrons_per_us,
    )
    return Rendering(planes, ambient, truth)


def _box(scene: Scene, sphere: ChromeSphere) -> tuple[slice, slice]:
    """Return the rows and columns that hold a sphere's outline, one pixel to spare.

    A cube around the sphere contains it, and a pinhole keeps it inside the cube's image.
    """
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    pixels = project(scene.camera, np.array(sphere.centre_mm) + sphere.radius_mm * corners)
    height, width = scene.camera.size
    low, high = np.floor(pixels.min(axis=0)) - 1, np.ceil(pixels.max(axis=0)) + 2
    left, top = (int(v) for v in np.clip(low, 0, (width, height)))
    right, bottom = (int(v) for v in np.clip(high, 0, (width, height)))
    return slice(top, bottom), slice(left, right)


def _draw_spheres(scene: Scene, planes: Values, ambient: Values) -> None:
    """Overwrite every pixel that a sphere touches, in place."""
    step = (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5
    sub_x, sub_y = (v.ravel() for v in np.meshgrid(step, step))
    samples = len(sub_x)
    for sphere in scene.spheres:
        rows, columns = _box(scene, sphere)
        y, x = (v.ravel() for v in np.mgrid[rows, columns])
        rays = pixel_rays(scene.camera, x[:, None] + sub_x, y[:, None] + sub_y)
        seen = trace_spheres(scene, rays.reshape(-1, 3))
        touched = (seen.sphere.reshape(-1, samples) >= 0).any(axis=1)
        if not touched.any():
            continue
        pick = np.repeat(touched, samples)
        y, x = y[touched], x[touched]
        hits = trace_surface(scene, rays[touched].reshape(-1, 3))
        mirrored, lost, share = seen.sphere[pick] >= 0, seen.lost[pick], seen.weight[pick]
        points = np.where(mirrored[:, None], seen.points_mm[pick], hits.points_mm)
        normals = np.where(mirrored[:, None], [0.0, 0.0, 1.0], hits.normals)
        on_object = np.where(mirrored, scene.inside(points[:, 0], points[:, 1]), hits.on_object)
        albedo = scene.albedo(points[:, 0], points[:, 1], on_object)
        weight = np.where(lost, 0.0, share * albedo)
        dim = scene.surroundings * np.where(lost, share, 0.0).reshape(-1, samples).mean(axis=1)
        lit = shade(scene, points, normals, weight, group=samples)
        planes[:, y, x] = lit + scene.irradiance[:, None] * dim
        ambient[y, x] = scene.ambient * (weight.reshape(-1, samples).mean(axis=1) + dim)
