"""Renderings larger than memory: rendered in bands of rows, and kept in temporary files."""

from __future__ import annotations

import math
import shutil
import tempfile
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt

from acquisition import BandFile, ComputedRows, DataError, MapRows, StorageError, storage_error
from rig import Progress, no_progress
from simulator._render.chrome import MirroredLights
from simulator._render.render import RowRenderer
from simulator._render.rendering import Rendering, Truth
from simulator._scene.scene import Scene

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Memory of a pixel of a band while it is rendered, and of all that depends on no pixel.
_BYTES_PER_LIGHT, _BYTES_PER_PIXEL, _BYTES_AT_WORK = 10, 150, 2**27
_MEMORY_BYTES = 2**30


class StoredRendering:
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
        _check_space(scene, folder)
        try:
            # The files stay open, and have no name, so that a killed process leaves nothing.
            with _temporary_folder(folder) as place:
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
            self._kept[name][rows] = _packed(values[:]) if _is_shadow(name) else values[:]

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
            def read(rows: slice) -> Mask:
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

    @property
    def highlights_px(self) -> Array:
        """Positions of the mirrored lights; see `Truth`."""
        return self._mirrored.pixels

    def close(self) -> None:
        """Remove the temporary files."""
        for file in self._files:
            file.close()

    def __enter__(self) -> Self:
        return self

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
    >>> from simulator import render_stored, scene_named
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


def _packed(mask: Mask) -> npt.NDArray[np.uint8]:
    return np.packbits(mask, axis=1)


def _temporary_folder(folder: Path) -> tempfile.TemporaryDirectory[str]:
    try:
        return tempfile.TemporaryDirectory(prefix=".sgp-", dir=folder)
    except OSError as error:
        raise storage_error(folder, "create a temporary folder", error) from error


def _check_space(scene: Scene, folder: Path) -> None:
    height, width = scene.lens.size
    # Images and packed shadows; ambient light, normals, height, albedo, masks.
    each = 4.125 * len(scene.lights) + 37 + len(scene.spheres)
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise storage_error(folder, "create a temporary folder", error) from error
    if each * height * width > free:
        raise StorageError(
            f"{folder}: the rendering needs {each * height * width / 1e6:,.0f} MB for temporary "
            f"files, but {free / 1e6:,.0f} MB are free: free space, or use a smaller image"
        )


def _rows_of_band(renderer: RowRenderer, memory_bytes: int) -> int:
    lights, width = len(renderer.scene.lights), renderer.scene.lens.size[1]
    each = width * (_BYTES_PER_LIGHT * lights + _BYTES_PER_PIXEL) * len(set(renderer.colours[:2]))
    rows = (memory_bytes - _BYTES_AT_WORK) // each - 2 * renderer.margin
    if rows < 1:
        least = _BYTES_AT_WORK + each * (1 + 2 * renderer.margin)
        raise DataError(
            f"rendering {lights} images of {width} pixels a row needs at least "
            f"{math.ceil(least / 1e6)} MB of memory: allow more, or use fewer lights"
        )
    return min(rows, renderer.scene.lens.size[0])
