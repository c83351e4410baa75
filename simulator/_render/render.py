"""Render a scene: one image per light, and the ground truth."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from rig import Progress, no_progress, short_repr
from simulator._render.blur import blur
from simulator._render.chrome import draw_mirrored_lights, find_mirrored_lights
from simulator._render.edges import shadow_edges, silhouettes
from simulator._render.shade import Shader
from simulator._render.trace import Seen, meets, see
from simulator._render.truth import Truth
from simulator._scene.scene import Scene

Array = npt.NDArray[np.float64]
Values = npt.NDArray[np.float32]
Whole = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

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
_POINTS = 65_536
# Memory of a rendering: an image and shadows for each light, maps of the truth, working memory.
_BYTES_PER_LIGHT, _BYTES_PER_PIXEL, _BYTES_AT_WORK = 5, 48, 2**27
# Smallest and largest number of samples of the shadow grid across the object.
_SHADOW_SAMPLES = (512, 3900)


@dataclass(frozen=True, eq=False)
class Rendering:
    """The images of a scene without noise.

    Parameters
    ----------
    planes
        ``(N, H, W)`` photons per microsecond of each light alone. With a Bayer lens, they are
        mosaics: each pixel has the value of its channel.
    ambient
        ``(H, W)`` photons per microsecond from the room, which are in every frame.
    truth
        Ground truth of the scene.
    scene
        The rendered scene.
    """

    planes: Values
    ambient: Values
    truth: Truth
    scene: Scene

    __repr__ = short_repr

    def plane(self, led: int | None) -> Values:
        """Return the image of one LED alone, or of the ambient light for None.

        Parameters
        ----------
        led
            Index of the LED, or None.

        Returns
        -------
        Values
            ``(H, W)`` photons per microsecond, a view and not a copy.

        Raises
        ------
        DataError
            If the scene has no such LED.
        """
        if led is None:
            return self.ambient
        if not 0 <= led < len(self.planes):
            raise DataError(f"LED {led} is not in the scene, which has {len(self.planes)} LEDs")
        alone: Values = self.planes[led]
        return alone


def render(scene: Scene, on_progress: Progress = no_progress) -> Rendering:
    """Render a scene under each of its lights.

    Object and board are sampled at the pixel's centre, with attached and cast shadows; a pattern
    with edges is averaged over the pixel. Pixels that a sphere or clutter touches are the mean of
    16 samples, and the mirrored lights are added as spots with exact positions and energies. Unless
    the lens is sharp, all edges are averaged over their pixels and the images are blurred. Not
    included are interreflections and light that spheres reflect onto the board.

    Parameters
    ----------
    scene
        Scene to render.
    on_progress
        Receives the stage ``rendering``, one step per row.

    Returns
    -------
    Rendering
        Images of the lights, ambient image and ground truth.

    Raises
    ------
    DataError
        If the rendering does not fit into memory, or the object cannot be traced or hides part of
        a sphere.

    Examples
    --------
    >>> from simulator import render, scene_named
    >>> rendering = render(scene_named("coin", width=64, height=52, leds=4))
    >>> rendering.planes.shape
    (4, 52, 64)
    >>> rendering.truth
    Truth(float32[52, 64, 3], 4 lights, 0 spheres)
    """
    _check_memory(scene)
    height, width = scene.lens.size
    # The blur mixes neighbours, so each colour of a mosaic is rendered as a whole image.
    colours = (0, 1, 2) if _blurs_colours(scene) else (None,)
    rows, done = max(1, _POINTS // width), 0
    canvas = _Canvas(scene, colours[0])
    for colour in colours:
        layer = canvas if colour == colours[0] else _Canvas(scene, colour)
        for top in range(0, height, rows):
            layer.draw_rows(top, min(top + rows, height))
            done += min(top + rows, height) - top
            on_progress("rendering", done, len(colours) * height)
        if not scene.lens.sharp:
            layer.blur()
        if layer is not canvas:
            canvas.take(layer)
    return canvas.finish()


def _blurs_colours(scene: Scene) -> bool:
    """Return whether the pixels of a mosaic see different colours and are blurred."""
    if scene.lens.cfa is None or scene.lens.sharp:
        return False
    patterns = (scene.pattern, scene.board)
    origin = np.zeros(1)
    intensities = np.asarray(scene.lights.intensities)
    return (
        any(pattern.evaluate(origin, origin).ndim == 2 for pattern in patterns)
        or any(np.ndim(item.albedo) > 0 for item in scene.clutter)
        or bool((intensities != intensities[:, :1]).any())
    )


class _Canvas:
    """Images and ground truth of a rendering in progress."""

    def __init__(self, scene: Scene, colour: int | None = None) -> None:
        self._scene = scene
        self._colour = colour
        self._shader = Shader(scene, _shadow_step_mm(scene))
        size, lights = scene.lens.size, len(scene.lights)
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

    def draw_rows(self, top: int, bottom: int) -> None:
        """Draw rows without mirrored lights and vignetting."""
        y, x = (v.ravel() for v in np.mgrid[top:bottom, : self._ambient.shape[1]])
        seen = see(self._scene, *self._rays(x, y))
        albedo = self._mean_albedo(seen, x, y) if self._scene.sharp else self._albedo_at(seen)
        lit, ambient, dark = self._shader.shade(seen, albedo, self._channel(x, y))
        self._planes[:, top:bottom] = lit.reshape(len(lit), bottom - top, -1)
        self._ambient[top:bottom] = ambient.reshape(bottom - top, -1)
        dark[:, ~seen.direct] = False
        self._shadows[:, top:bottom] = dark.reshape(len(dark), bottom - top, -1)
        self._sphere[top:bottom] = seen.sphere.reshape(bottom - top, -1)
        self._label[top:bottom] = _labels(seen, len(self._scene.spheres)).reshape(bottom - top, -1)
        self._depth[top:bottom] = seen.depth_mm.reshape(bottom - top, -1)
        on = seen.on_object & seen.direct
        y, x = y[on], x[on]
        self._mask[y, x] = True
        self._normals[y, x] = seen.normals[on]
        self._height[y, x] = seen.points_mm[on, 2]
        self._albedo[y, x] = albedo[on]
        for rows, columns in self._windows:
            if max(rows.start, top) < min(rows.stop, bottom):
                self._draw_finely(slice(max(rows.start, top), min(rows.stop, bottom)), columns)

    def _draw_finely(self, rows: slice, columns: slice) -> None:
        """Draw again, with 16 samples, the pixels of a window that sphere or clutter touches."""
        y, x = (v.ravel() for v in np.mgrid[rows, columns])
        self._draw_again(y, x, only_met=True)

    def _draw_again(self, all_y: Whole, all_x: Whole, *, only_met: bool) -> None:
        """Draw pixels with 16 samples: all, or those that sphere or clutter touches."""
        # The even grid, kept for sharp lenses, is exact to 1/8 pixel at edges along the axes.
        sharp, samples = self._scene.lens.sharp, len(_GRID_X)
        shift_x, shift_y = (_GRID_X, _GRID_Y) if sharp else (_LATTICE_X, _LATTICE_Y)
        for start in range(0, len(all_x), _POINTS // samples):
            part = slice(start, start + _POINTS // samples)
            y, x = all_y[part], all_x[part]
            origins, rays = self._rays(x[:, None] + shift_x, y[:, None] + shift_y)
            met = np.ones(len(x), np.bool_)
            if only_met:
                met[:] = meets(self._scene, origins, rays).reshape(-1, samples).any(axis=1)
                if not met.any():
                    continue
            y, x, pick = y[met], x[met], np.repeat(met, samples)
            self._fine[y, x] = True
            seen = see(self._scene, origins[pick], rays[pick])
            channel = np.repeat(self._channel(x, y), samples)
            lit, ambient, _ = self._shader.shade(seen, self._albedo_at(seen), channel)
            self._planes[:, y, x] = lit.reshape(len(lit), -1, samples).mean(axis=2)
            self._ambient[y, x] = ambient.reshape(-1, samples).mean(axis=1)

    def blur(self) -> None:
        """Integrate edges over pixels, then blur all images as the lens does."""
        lens = self._scene.lens
        # A pixel on the object.
        step = self._depth / lens.camera.K[0, 0] if lens.camera else float(lens.pixel_mm or 0.0)
        edge = silhouettes(self._label, self._depth, step) & ~self._fine
        self._integrate_shadows(~(self._fine | edge))
        self._draw_again(*np.nonzero(edge), only_met=False)
        circle = lens.circle_px(self._depth).astype(np.float32)
        for images in (self._planes, self._ambient[None]):
            blur(images, self._depth, circle, lens.blur_px)

    def _integrate_shadows(self, allowed: Mask) -> None:
        """Average the edges of shadows over their pixels."""
        edges = [shadow_edges(dark, self._label) & allowed for dark in self._shadows]
        y, x = np.nonzero(np.logical_or.reduce(edges)) if edges else _NOWHERE
        for start in range(0, len(x), _POINTS // 4):
            part = slice(start, start + _POINTS // 4)
            self._integrate_part(edges, y[part], x[part])

    def _integrate_part(self, edges: list[Mask], y: Whole, x: Whole) -> None:
        seen = see(self._scene, *self._rays(x, y))
        albedo = self._mean_albedo(seen, x, y) if self._scene.sharp else self._albedo_at(seen)
        samples = np.stack(list(self._around(seen, x, y)))
        channel = self._channel(x, y)
        for led, edge in enumerate(edges):
            on = np.flatnonzero(edge[y, x])
            if on.size:
                self._planes[led, y[on], x[on]] = self._shader.shade_partly(
                    led, seen.at(on), albedo[on], channel[on], samples[:, on]
                )

    def take(self, other: _Canvas) -> None:
        """Take the pixels of another colour of the mosaic."""
        height, width = self._ambient.shape
        y, x = np.mgrid[:height, :width]
        own = self._scene.lens.channel(x, y) == other._colour
        self._planes[:, own] = other._planes[:, own]
        self._ambient[own] = other._ambient[own]

    def finish(self) -> Rendering:
        """Add mirrored lights and vignetting, and return the rendering."""
        scene, lens = self._scene, self._scene.lens
        mirrored = find_mirrored_lights(scene, self._shader.occluders)
        draw_mirrored_lights(scene, mirrored, self._planes)
        height, width = lens.size
        for row in range(height):
            gain = scene.electrons_per_us * lens.vignette(np.arange(width), row)
            self._planes[:, row] *= gain.astype(np.float32)
            self._ambient[row] *= gain.astype(np.float32)
        table = scene.sphere_table
        truth = Truth(
            normals=self._normals,
            height_mm=self._height,
            albedo=self._albedo if scene.coloured else self._albedo[..., 0].copy(),
            mask=self._mask,
            sphere_masks=self._sphere == np.arange(len(table))[:, None, None],
            sphere_centres_mm=table[:, :3],
            sphere_radii_mm=table[:, 3],
            highlights_px=mirrored.pixels,
            lights=scene.lights,
            lens=scene.lens,
            noise=scene.noise,
            electrons_per_us=scene.electrons_per_us,
            shadows=self._shadows,
        )
        return Rendering(self._planes, self._ambient, truth, scene)

    def _rays(self, x: Array | Whole, y: Array | Whole) -> tuple[Array, Array]:
        origins, rays = self._scene.lens.origins_and_rays(x.ravel(), y.ravel())
        return np.ascontiguousarray(origins), np.ascontiguousarray(rays)

    def _channel(self, x: Whole, y: Whole) -> npt.NDArray[np.int8]:
        if self._colour is not None:
            return np.full(len(x), self._colour, np.int8)
        channel = self._scene.lens.channel(x, y)
        return np.full(len(x), -1, np.int8) if channel is None else channel.astype(np.int8)

    def _albedo_at(self, seen: Seen) -> Values:
        x, y = seen.points_mm[:, 0], seen.points_mm[:, 1]
        return self._scene.albedo(x, y, seen.on_object, seen.item)

    def _mean_albedo(self, seen: Seen, x: Whole, y: Whole) -> Values:
        """Return the mean albedo over each pixel, on the tangent plane of the point it sees."""
        mean = np.zeros((len(x), 3), np.float32)
        for points in self._around(seen, x, y):
            mean += self._scene.albedo(points[:, 0], points[:, 1], seen.on_object, seen.item)
        return mean / np.float32(len(_LATTICE_X))

    def _around(self, seen: Seen, x: Whole, y: Whole) -> Iterator[Array]:
        """Yield points ``(n, 3)`` that are spread over each pixel, on the tangent plane."""
        for shift_x, shift_y in zip(_LATTICE_X, _LATTICE_Y, strict=True):
            origins, rays = self._rays(x + shift_x, y + shift_y)
            fall = (rays * seen.normals).sum(axis=1)
            steep = fall > -_GRAZING
            depth = ((seen.points_mm - origins) * seen.normals).sum(axis=1)
            points = origins + (depth / np.where(steep, -1.0, fall))[:, None] * rays
            points[steep] = seen.points_mm[steep]
            yield points


def _labels(seen: Seen, spheres: int) -> npt.NDArray[np.int64]:
    """Return a number for each object: spheres from 0, then clutter; board -1, object -2."""
    flat = np.where(seen.on_object, -2, -1)
    own = np.where(seen.item >= 0, seen.item + spheres, flat)
    return np.where(seen.direct, own, seen.sphere)


def _shadow_step_mm(scene: Scene) -> float:
    """Return half a pixel on the board, limited by the size of a grid over the object."""
    rows, columns = scene.lens.size
    x = np.array([0.0, 1.0]) + (columns - 1) / 2
    origins, rays = scene.lens.origins_and_rays(x, np.full(2, (rows - 1) / 2))
    first, second = origins + scene.lens.camera_z_mm * rays
    step = float(np.linalg.norm(second - first)) / 2
    across = 0.0 if scene.body is None else 2 * scene.body.radius_mm
    fewest, most = _SHADOW_SAMPLES
    return min(max(step, across / most), across / fewest) if across else step


def _check_memory(scene: Scene) -> None:
    height, width = scene.lens.size
    each = _BYTES_PER_LIGHT * len(scene.lights) + _BYTES_PER_PIXEL
    each *= 2 if _blurs_colours(scene) else 1
    required, available = float(each * height * width + _BYTES_AT_WORK), _memory_bytes()
    if required > available:
        raise DataError(
            f"rendering {len(scene.lights)} images of {width} x {height} pixels requires "
            f"{required / 2**30:.1f} GiB, but only {available / 2**30:.1f} GiB are available: "
            "use fewer lights or a smaller image"
        )


def _memory_bytes() -> float:
    """Return the available memory; infinity if the system does not report it."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        kib = next(line.split()[1] for line in lines if line.startswith("MemAvailable"))
        return 1024.0 * int(kib)
    except (OSError, StopIteration):
        pass
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return math.inf
