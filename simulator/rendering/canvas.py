"""Rows of the images and of the ground truth of a scene, as they are drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from rig.arrays import Bool, Float32, Float64, Int8, Int16, Int64
from simulator.rendering.blur import blur
from simulator.rendering.chrome import MirroredLights, draw_mirrored_lights
from simulator.rendering.rendering import Rendering, Truth
from simulator.rendering.shade import Shader
from simulator.rendering.trace import Seen, meets, see
from simulator.scene.scene import Scene

_NOWHERE = np.zeros(0, np.int64), np.zeros(0, np.int64)

# The 4 x 4 samples within a pixel that a sphere touches.
_GRID_X, _GRID_Y = (v.ravel() for v in np.meshgrid(*[(np.arange(4) + 0.5) / 4 - 0.5] * 2))
# Samples of a pattern with edges. No two are in one row or column, so edges along the axes, the
# most frequent ones, are exact to 1/32 pixel.
_LATTICE_X = (np.arange(16) + 0.5) / 16 - 0.5
_LATTICE_Y = _LATTICE_X[np.arange(16) * 5 % 16]
# Cosine between ray and surface below which the tangent plane does not represent the pixel.
_GRAZING = 0.1
# Points shaded at once: enough for all cores, few enough for the caches.
POINTS = 65_536


class Canvas:
    """Some rows of the images and of the ground truth, in progress.

    Parameters
    ----------
    scene
        The scene.
    shader
        Its shader.
    rows
        First row, and the one after the last. Rows in all methods count from the top of the image.
    colour
        Channel that all pixels see; None for that of each pixel.
    """

    def __init__(
        self, scene: Scene, shader: Shader, rows: tuple[int, int], colour: int | None = None
    ) -> None:
        self._scene = scene
        self._colour = colour
        self._shader = shader
        self._top, bottom = rows
        size, lights = (bottom - self._top, scene.lens.size[1]), len(scene.lights)
        self._planes = np.zeros((lights, *size), np.float32)
        self._ambient = np.zeros(size, np.float32)
        self._shadows = np.zeros((lights, *size), np.bool_)
        self._normals = np.zeros((*size, 3), np.float32)
        self._height = np.full(size, np.nan)
        self._albedo = np.zeros((*size, 3), np.float32)
        self._mask = np.zeros(size, np.bool_)
        self._sphere = np.full(size, -1, np.int16)
        # Number of the object that a pixel shows, and its depth; pixels drawn finely.
        self._label = np.zeros(size, np.int16)
        self._depth = np.zeros(size)
        self._fine = np.zeros(size, np.bool_)
        self._windows = [scene.lens.window(s.centre_mm, s.radius_mm) for s in scene.spheres]
        self._windows += [scene.lens.window(c.centre_mm, c.reach_mm) for c in scene.clutter]

    def draw(self, advance: Callable[[int], None]) -> None:
        """Draw all rows without mirrored lights and vignetting; call ``advance`` with a number."""
        height, width = self._ambient.shape
        step, end = max(1, POINTS // width), self._top + height
        for top in range(self._top, end, step):
            self._draw_rows(top, min(top + step, end))
            advance(min(top + step, end) - top)

    def _draw_rows(self, top: int, bottom: int) -> None:
        y, x = (v.ravel() for v in np.mgrid[top:bottom, : self._ambient.shape[1]])
        rows = slice(top - self._top, bottom - self._top)
        seen = see(self._scene, *self._rays(x, y))
        albedo = self._mean_albedo(seen, x, y) if self._scene.sharp else self._albedo_at(seen)
        lit, ambient, dark = self._shader.shade(seen, albedo, self._channel(x, y))
        self._planes[:, rows] = lit.reshape(len(lit), bottom - top, -1)
        self._ambient[rows] = ambient.reshape(bottom - top, -1)
        dark[:, ~seen.direct] = False
        self._shadows[:, rows] = dark.reshape(len(dark), bottom - top, -1)
        self._sphere[rows] = seen.sphere.reshape(bottom - top, -1)
        self._label[rows] = _labels(seen, len(self._scene.spheres)).reshape(bottom - top, -1)
        self._depth[rows] = seen.depth_mm.reshape(bottom - top, -1)
        on = seen.on_object & seen.direct
        y, x = y[on] - self._top, x[on]
        self._mask[y, x] = True
        self._normals[y, x] = seen.normals[on]
        self._height[y, x] = seen.points_mm[on, 2]
        self._albedo[y, x] = albedo[on]
        for high, wide in self._windows:
            first, last = max(high.start, top), min(high.stop, bottom)
            if first < last:
                y, x = (v.ravel() for v in np.mgrid[first:last, wide])
                self._draw_again(y, x, only_met=True)

    def _draw_again(self, all_y: Int64, all_x: Int64, *, only_met: bool) -> None:
        """Draw pixels with 16 samples: all, or those that sphere or clutter touches."""
        # The even grid, kept for sharp lenses, is exact to 1/8 pixel at edges along the axes.
        sharp, samples = self._scene.lens.sharp, len(_GRID_X)
        shift_x, shift_y = (_GRID_X, _GRID_Y) if sharp else (_LATTICE_X, _LATTICE_Y)
        for start in range(0, len(all_x), POINTS // samples):
            part = slice(start, start + POINTS // samples)
            y, x = all_y[part], all_x[part]
            origins, rays = self._rays(x[:, None] + shift_x, y[:, None] + shift_y)
            met = np.ones(len(x), np.bool_)
            if only_met:
                met[:] = meets(self._scene, origins, rays).reshape(-1, samples).any(axis=1)
                if not met.any():
                    continue
            y, x, pick = y[met], x[met], np.repeat(met, samples)
            seen = see(self._scene, origins[pick], rays[pick])
            channel = np.repeat(self._channel(x, y), samples)
            lit, ambient, _ = self._shader.shade(seen, self._albedo_at(seen), channel)
            y = y - self._top
            self._fine[y, x] = True
            self._planes[:, y, x] = lit.reshape(len(lit), -1, samples).mean(axis=2)
            self._ambient[y, x] = ambient.reshape(-1, samples).mean(axis=1)

    def blur(self, largest_px: float | None = None) -> None:
        """Integrate edges over pixels, then blur all images as the lens does.

        ``largest_px`` is the largest circle of confusion of the image; None for that of these rows.
        """
        lens = self._scene.lens
        # A pixel on the object.
        step = self._depth / lens.camera.K[0, 0] if lens.camera else float(lens.pixel_mm or 0.0)
        edge = silhouettes(self._label, self._depth, step) & ~self._fine
        self._integrate_shadows(~(self._fine | edge))
        y, x = np.nonzero(edge)
        self._draw_again(y + self._top, x, only_met=False)
        circle = lens.circle_px(self._depth).astype(np.float32)
        for images in (self._planes, self._ambient[None]):
            blur(images, self._depth, circle, lens.blur_px, largest_px)

    def _integrate_shadows(self, allowed: Bool) -> None:
        """Average the edges of shadows over their pixels."""
        edges = [_beside(dark, self._label) & allowed for dark in self._shadows]
        y, x = np.nonzero(np.logical_or.reduce(edges)) if edges else _NOWHERE
        for start in range(0, len(x), POINTS // 4):
            part = slice(start, start + POINTS // 4)
            self._integrate_part(edges, y[part], x[part])

    def _integrate_part(self, edges: list[Bool], y: Int64, x: Int64) -> None:
        place = x, y + self._top
        seen = see(self._scene, *self._rays(*place))
        albedo = self._mean_albedo(seen, *place) if self._scene.sharp else self._albedo_at(seen)
        samples = np.stack(list(self._around(seen, *place)))
        channel = self._channel(*place)
        for led, edge in enumerate(edges):
            on = np.flatnonzero(edge[y, x])
            if on.size:
                self._planes[led, y[on], x[on]] = self._shader.shade_partly(
                    led, seen.at(on), albedo[on], channel[on], samples[:, on]
                )

    def take(self, other: Canvas) -> None:
        """Take the pixels of another colour of the mosaic."""
        height, width = self._ambient.shape
        y, x = np.mgrid[self._top : self._top + height, :width]
        own = self._scene.lens.channel(x, y) == other._colour
        self._planes[:, own] = other._planes[:, own]
        self._ambient[own] = other._ambient[own]

    def finish(self, mirrored: MirroredLights) -> Rendering:
        """Add mirrored lights and vignetting, and return the rendering."""
        scene, lens = self._scene, self._scene.lens
        draw_mirrored_lights(scene, mirrored, self._planes, top=self._top)
        height, width = self._ambient.shape
        for row in range(height):
            gain = scene.electrons_per_us * lens.vignette(np.arange(width), self._top + row)
            self._planes[:, row] *= gain.astype(np.float32)
            self._ambient[row] *= gain.astype(np.float32)
        truth = Truth.of(
            scene,
            mirrored.pixels,
            normals=self._normals,
            height_mm=self._height,
            albedo=self._albedo if scene.coloured else self._albedo[..., 0].copy(),
            mask=self._mask,
            sphere_masks=self._sphere == np.arange(len(scene.spheres))[:, None, None],
            shadows=self._shadows,
            top=self._top,
        )
        return Rendering(self._planes, self._ambient, truth, scene)

    def _rays(self, x: Float64 | Int64, y: Float64 | Int64) -> tuple[Float64, Float64]:
        origins, rays = self._scene.lens.origins_and_rays(x.ravel(), y.ravel())
        return np.ascontiguousarray(origins), np.ascontiguousarray(rays)

    def _channel(self, x: Int64, y: Int64) -> Int8:
        if self._colour is not None:
            return np.full(len(x), self._colour, np.int8)
        channel = self._scene.lens.channel(x, y)
        return np.full(len(x), -1, np.int8) if channel is None else channel.astype(np.int8)

    def _albedo_at(self, seen: Seen) -> Float32:
        x, y = seen.points_mm[:, 0], seen.points_mm[:, 1]
        return self._scene.albedo(x, y, seen.on_object, seen.item)

    def _mean_albedo(self, seen: Seen, x: Int64, y: Int64) -> Float32:
        """Return the mean albedo over each pixel, on the tangent plane of the point it sees."""
        mean = np.zeros((len(x), 3), np.float32)
        for points in self._around(seen, x, y):
            mean += self._scene.albedo(points[:, 0], points[:, 1], seen.on_object, seen.item)
        return mean / np.float32(len(_LATTICE_X))

    def _around(self, seen: Seen, x: Int64, y: Int64) -> Iterator[Float64]:
        """Yield points ``(n, 3)`` that are spread over each pixel, on the tangent plane."""
        for shift_x, shift_y in zip(_LATTICE_X, _LATTICE_Y, strict=True):
            origins, rays = self._rays(x + shift_x, y + shift_y)
            fall = (rays * seen.normals).sum(axis=1)
            steep = fall > -_GRAZING
            depth = ((seen.points_mm - origins) * seen.normals).sum(axis=1)
            points = origins + (depth / np.where(steep, -1.0, fall))[:, None] * rays
            points[steep] = seen.points_mm[steep]
            yield points


def _labels(seen: Seen, spheres: int) -> Int64:
    """Return a number for each object: spheres from 0, then clutter; board -1, object -2."""
    flat = np.where(seen.on_object, -2, -1)
    own = np.where(seen.item >= 0, seen.item + spheres, flat)
    return np.where(seen.direct, own, seen.sphere)


def silhouettes(label: Int16, depth_mm: Float64, step_mm: Float64 | float) -> Bool:
    """Return the pixels on both sides of an edge between objects, and at steps of an object.

    Parameters
    ----------
    label
        ``(H, W)`` number of the object that a pixel shows.
    depth_mm
        ``(H, W)`` depth of what it shows.
    step_mm
        Second difference of the depth that counts as a step or a crease.
    """
    edge = _beside(label)
    step = np.broadcast_to(step_mm, depth_mm.shape)
    for axis in range(2):
        bend = np.abs(np.diff(depth_mm, 2, axis=axis))
        inner = [slice(None), slice(None)]
        inner[axis] = slice(1, -1)
        edge[tuple(inner)] |= bend > step[tuple(inner)]
    return edge


def _beside(values: Int16 | Bool, same: Int16 | None = None) -> Bool:
    """Return the pixels on both sides of an edge; if objects are given, not of one between them."""
    edge = np.zeros(values.shape, np.bool_)
    for axis in range(2):
        first: list[slice] = [slice(None), slice(None)]
        second: list[slice] = [slice(None), slice(None)]
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        one, two = tuple(first), tuple(second)
        differs = values[one] != values[two]
        if same is not None:
            differs &= same[one] == same[two]
        edge[one] |= differs
        edge[two] |= differs
    return edge
