"""Render a scene: one image per light, and the ground truth."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cached_property
from pathlib import Path

import numpy as np

from acquisition import DataError, MapRows, StorageError
from acquisition.files import BandFile, ComputedRows, storage_error
from rig import Progress, no_progress
from rig.arrays import Bool
from rig.processes import memory_of_computer
from simulator.rendering.blur import blur_reach
from simulator.rendering.canvas import POINTS, Canvas
from simulator.rendering.chrome import MirroredLights, find_mirrored_lights
from simulator.rendering.rendering import Rendering, Truth
from simulator.rendering.shade import Shader
from simulator.rendering.trace import see
from simulator.scene.scene import Scene

# Memory of a rendering: an image and shadows for each light, maps of the truth, working memory.
_BYTES_PER_LIGHT, _BYTES_PER_PIXEL, _BYTES_AT_WORK = 5, 48, 2**27
# Smallest and largest number of samples of the shadow grid across the object.
_SHADOW_SAMPLES = (512, 3900)
# Memory of a pixel of a band while it is rendered, and of all that depends on no pixel.
_STORED_PER_LIGHT, _STORED_PER_PIXEL, _STORED_AT_WORK = 10, 150, 2**27
_MEMORY_BYTES = 2**30


class StoredRendering(AbstractContextManager["StoredRendering"]):
    """A rendering in temporary files, from `render_stored`; use it as a context manager.

    Attributes
    ----------
    scene
        The rendered scene.
    """

    def __init__(self, scene: Scene, folder: Path, mirrored: MirroredLights) -> None:
        self.scene = scene
        self._mirrored = mirrored
        width, lights = scene.lens.size[1], len(scene.lights)
        self._files: list[BandFile] = []
        try:
            # The files stay open, and have no name, so that a killed process leaves nothing.
            with _temporary_folder(scene, folder) as place:
                self._place = Path(place)
                self._planes = [self._file(np.float32, width) for _ in range(lights)]
                self._ambient = self._file(np.float32, width)
                self._kept = {
                    "normals": self._file(np.float32, width, 3),
                    "height": self._file(np.float64, width),
                    "albedo": self._file(np.float32, width, *([3] if scene.coloured else [])),
                    "mask": self._file(np.bool_, width),
                }
                for index in range(len(scene.spheres)):
                    self._kept[f"sphere_{index}"] = self._file(np.bool_, width)
                # Eight pixels in a byte.
                for light in scene.lights.ids:
                    self._kept[f"shadows/{light}"] = self._file(np.uint8, -(-width // 8))
        except BaseException:
            self.close()
            raise

    def _file(self, dtype: type[np.generic], *shape: int) -> BandFile:
        path = self._place / str(len(self._files))
        height = self.scene.lens.size[0]
        self._files.append(BandFile(path, (height, *shape), np.dtype(dtype)))
        return self._files[-1]

    def put(self, part: Rendering) -> None:
        """Keep the rows of a rendering."""
        rows = slice(part.truth.top, part.truth.top + len(part.ambient))
        self._ambient[rows] = part.ambient
        for kept, plane in zip(self._planes, part.planes, strict=True):
            kept[rows] = plane
        for name, values in part.maps.items():
            packed = np.packbits(values[:], axis=1) if _is_shadow(name) else values[:]
            self._kept[name][rows] = packed

    def plane(self, led: int | None) -> BandFile:
        """Return the image of one LED alone, or of the ambient light for None; see `Rendering`."""
        if led is None:
            return self._ambient
        if not 0 <= led < len(self._planes):
            raise DataError(f"LED {led} is not in the scene, which has {len(self._planes)} LEDs")
        return self._planes[led]

    @property
    def maps(self) -> dict[str, MapRows]:
        """The maps of the ground truth by the names of their files; see `truth_maps`."""
        size = self.scene.lens.size

        def unpacked(kept: BandFile) -> ComputedRows:
            def read(rows: slice) -> Bool:
                return np.unpackbits(kept[rows], axis=1, count=size[1]).view(np.bool_)

            return ComputedRows(size, np.dtype(np.bool_), read)

        return {
            name: unpacked(kept) if _is_shadow(name) else kept for name, kept in self._kept.items()
        }

    def truth_of(self, rows: slice) -> Truth:
        """Return the ground truth of some rows."""
        scene, maps = self.scene, self.maps
        spheres = [maps[f"sphere_{index}"][rows] for index in range(len(scene.spheres))]
        mask = maps["mask"][rows]
        return Truth.of(
            scene,
            self._mirrored.pixels,
            normals=maps["normals"][rows],
            height_mm=maps["height"][rows],
            albedo=maps["albedo"][rows],
            mask=mask,
            sphere_masks=np.array(spheres, np.bool_).reshape(-1, *mask.shape),
            shadows=np.stack([maps[name][rows] for name in maps if _is_shadow(name)]),
            top=rows.start,
        )

    def close(self) -> None:
        """Remove the temporary files."""
        for file in self._files:
            file.close()

    def __exit__(self, *_: object) -> None:
        self.close()


def render_stored(
    scene: Scene,
    folder: Path | str,
    *,
    memory_bytes: int = _MEMORY_BYTES,
    on_progress: Progress = no_progress,
) -> StoredRendering:
    """Render a scene in bands of rows, and keep the images in temporary files.

    Values are equal to those of `render`. The rows that the blur of the lens needs around a band
    are rendered with it.

    Parameters
    ----------
    scene
        Scene to render.
    folder
        Folder of the temporary files, which have no names there and end with the process.
    memory_bytes
        Memory that may be used.
    on_progress
        Receives the stage ``rendering``, one step per row.

    Returns
    -------
    StoredRendering
        The rendering; close it to remove the files.

    Raises
    ------
    DataError
        As `render`, or if ``memory_bytes`` is too little for one row.
    StorageError
        If the disk has too little space, or refuses a file.

    Examples
    --------
    >>> from simulator import scene_named
    >>> from simulator.rendering import render_stored
    >>> with render_stored(scene_named("coin", width=64, height=52, leds=4), ".") as stored:
    ...     stored.plane(2)[10:12].shape, stored.maps["normals"].shape
    ((2, 64), (52, 64, 3))
    """
    folder, renderer, height = Path(folder), RowRenderer(scene), scene.lens.size[0]
    step = _rows_of_band(renderer, memory_bytes)
    stored = StoredRendering(scene, folder, renderer.mirrored)
    try:
        for first in range(0, height, step):
            last = min(first + step, height)
            stored.put(renderer.rows(first, last, lambda _: None))
            on_progress("rendering", last, height)
    except BaseException:
        stored.close()
        raise
    return stored


def _is_shadow(name: str) -> bool:
    return name.startswith("shadows/")


def _temporary_folder(scene: Scene, folder: Path) -> tempfile.TemporaryDirectory[str]:
    """Return a temporary folder on a disk that has space for the images."""
    height, width = scene.lens.size
    # Images and packed shadows; ambient light, normals, height, albedo, masks.
    each = 4.125 * len(scene.lights) + 37 + len(scene.spheres)
    try:
        free = shutil.disk_usage(folder).free
        made = tempfile.TemporaryDirectory(prefix=".sgp-", dir=folder)
    except OSError as error:
        raise storage_error(folder, "create a temporary folder", error) from error
    if each * height * width > free:
        made.cleanup()
        raise StorageError(
            f"{folder}: the rendering needs {each * height * width / 1e6:,.0f} MB for temporary "
            f"files, but {free / 1e6:,.0f} MB are free: free space, or use a smaller image"
        )
    return made


def _rows_of_band(renderer: RowRenderer, memory_bytes: int) -> int:
    lights, width = len(renderer.scene.lights), renderer.scene.lens.size[1]
    each = width * (_STORED_PER_LIGHT * lights + _STORED_PER_PIXEL) * len(set(renderer.colours[:2]))
    rows = (memory_bytes - _STORED_AT_WORK) // each - 2 * renderer.margin
    if rows < 1:
        least = _STORED_AT_WORK + each * (1 + 2 * renderer.margin)
        raise DataError(
            f"rendering {lights} images of {width} pixels a row needs at least "
            f"{math.ceil(least / 1e6)} MB of memory: allow more, or use fewer lights"
        )
    return min(rows, renderer.scene.lens.size[0])


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
    >>> from simulator import scene_named
    >>> from simulator.rendering import rendering_bytes
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
