"""Render a scene: one image per light, and the ground truth."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from acquisition import DataError
from rig import Progress, memory_of_computer, no_progress
from simulator._render.blur import blur_reach
from simulator._render.canvas import POINTS, Canvas
from simulator._render.chrome import MirroredLights, find_mirrored_lights
from simulator._render.rendering import Rendering
from simulator._render.shade import Shader
from simulator._render.trace import see
from simulator._scene.scene import Scene

# Memory of a rendering: an image and shadows for each light, maps of the truth, working memory.
_BYTES_PER_LIGHT, _BYTES_PER_PIXEL, _BYTES_AT_WORK = 5, 48, 2**27
# Smallest and largest number of samples of the shadow grid across the object.
_SHADOW_SAMPLES = (512, 3900)


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
    renderer, height, done = RowRenderer(scene), scene.lens.size[0], 0

    def advance(rows: int) -> None:
        nonlocal done
        done += rows
        on_progress("rendering", done, len(renderer.colours) * height)

    return renderer.rows(0, height, advance)


class RowRenderer:
    """Renders rows of a scene; they are equal to those of the complete image."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._shader = Shader(scene, _shadow_step_mm(scene))
        # The blur mixes neighbours, so each colour of a mosaic is rendered as a whole image.
        self.colours = (0, 1, 2) if _blurs_colours(scene) else (None,)

    def rows(self, first: int, last: int, advance: Callable[[int], None]) -> Rendering:
        """Render the rows from ``first`` to before ``last``; ``advance`` counts rows drawn."""
        height = self.scene.lens.size[0]
        complete = (first, last) == (0, height)
        margin = 0 if complete else self.margin
        drawn = max(0, first - margin), min(last + margin, height)
        largest_px = None if complete else self._largest_circle_px
        canvas = Canvas(self.scene, self._shader, drawn, self.colours[0])
        for colour in self.colours:
            layer = canvas
            if colour != self.colours[0]:
                layer = Canvas(self.scene, self._shader, drawn, colour)
            layer.draw(advance)
            if not self.scene.lens.sharp:
                layer.blur(largest_px)
            if layer is not canvas:
                canvas.take(layer)
        rendering = canvas.finish(self.mirrored)
        return rendering if complete else rendering.rows(first - drawn[0], last - drawn[0])

    @property
    def margin(self) -> int:
        """Number of rows above and below that the blur of a row needs."""
        lens = self.scene.lens
        if lens.sharp:
            return 0
        # One more, because edges are pixels with unlike neighbours.
        return blur_reach(self._largest_circle_px, lens.blur_px) + 1

    @cached_property
    def _largest_circle_px(self) -> float:
        """Diameter of the largest circle of confusion in the image."""
        lens, largest = self.scene.lens, 0.0
        height, width = lens.size
        if lens.sharp or lens.camera is None:
            return largest
        step = max(1, POINTS // width)
        for top in range(0, height, step):
            y, x = (v.ravel() for v in np.mgrid[top : min(top + step, height), :width])
            origins, rays = (np.ascontiguousarray(v) for v in lens.origins_and_rays(x, y))
            circle = lens.circle_px(see(self.scene, origins, rays).depth_mm).astype(np.float32)
            largest = max(largest, float(circle.max()))
        return largest

    @cached_property
    def mirrored(self) -> MirroredLights:
        """The lights that spheres mirror."""
        return find_mirrored_lights(self.scene, self._shader.occluders)


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


def rendering_bytes(scene: Scene) -> int:
    """Return the memory that `render` needs for a scene, in bytes.

    Examples
    --------
    >>> from simulator import rendering_bytes, scene_named
    >>> rendering_bytes(scene_named("coin", width=64, height=52, leds=4)) < 2**30
    True
    """
    height, width = scene.lens.size
    each = _BYTES_PER_LIGHT * len(scene.lights) + _BYTES_PER_PIXEL
    each *= 2 if _blurs_colours(scene) else 1
    return each * height * width + _BYTES_AT_WORK


def _check_memory(scene: Scene) -> None:
    required, (_, available) = rendering_bytes(scene), memory_of_computer()
    if available is not None and required > available:
        height, width = scene.lens.size
        raise DataError(
            f"rendering {len(scene.lights)} images of {width} x {height} pixels requires "
            f"{required / 2**30:.1f} GiB, but only {available / 2**30:.1f} GiB are available: "
            "use fewer lights or a smaller image"
        )
