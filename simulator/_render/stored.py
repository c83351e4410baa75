"""Renderings larger than memory: rendered in bands of rows, and kept in a temporary file."""

from __future__ import annotations

import math
import shutil
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from acquisition import DataError, StorageError, storage_error
from rig import Progress, no_progress, short_repr
from simulator._render.chrome import MirroredLights
from simulator._render.render import RowRenderer
from simulator._render.rendering import Rendering
from simulator._render.truth import Truth
from simulator._scene.scene import Scene

# Memory of a pixel of a band while it is rendered, and of all that depends on no pixel.
_BYTES_PER_LIGHT, _BYTES_PER_PIXEL, _BYTES_AT_WORK = 10, 150, 2**28
_MEMORY_BYTES = 2**30


class _File:
    """A temporary file without a name, in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._lock, self.end = folder, threading.Lock(), 0
        try:
            self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115
        except OSError as error:
            raise storage_error(folder, "create a temporary file", error) from error
        self.close = self._file.close

    def read(self, begin: int, data: memoryview) -> None:
        try:
            with self._lock:
                self._file.seek(begin)
                while data:
                    count = self._file.readinto(data)
                    if not count:
                        raise StorageError(f"{self._folder}: the temporary file was cut short")
                    data = data[count:]
        except OSError as error:
            raise storage_error(self._folder, "read rendered images", error) from error

    def write(self, begin: int, data: memoryview) -> None:
        try:
            with self._lock:
                self._file.seek(begin)
                while data:
                    data = data[self._file.write(data) :]
        except OSError as error:
            raise storage_error(self._folder, "keep rendered images", error) from error


@dataclass(frozen=True, eq=False)
class StoredRows:
    """An array in a file, whose rows are read where they are used: ``stored[first:last]``.

    Parameters
    ----------
    file, begin
        The file, and the place of the array in it.
    shape, dtype
        As of an array.
    """

    file: _File
    begin: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    __repr__ = short_repr

    def __getitem__(self, rows: slice) -> npt.NDArray[Any]:
        first, last, _ = rows.indices(self.shape[0])
        values = np.zeros((max(last - first, 0), *self.shape[1:]), self.dtype)
        if values.size:
            self.file.read(self.begin + first * values[0].nbytes, values.data.cast("B"))
        return values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.asarray(self[:], dtype)

    def put(self, first: int, values: npt.NDArray[Any]) -> None:
        """Write rows from ``first`` on."""
        rows = np.ascontiguousarray(values, self.dtype)
        self.file.write(self.begin + first * rows[0].nbytes, rows.data.cast("B"))

    @property
    def nbytes(self) -> int:
        """Size of the array in bytes."""
        return math.prod(self.shape) * self.dtype.itemsize


class StoredRendering:
    """A rendering in a temporary file, from `render_stored`; use it as a context manager.

    Attributes
    ----------
    scene
        The rendered scene.
    """

    def __init__(self, scene: Scene, folder: Path, mirrored: MirroredLights) -> None:
        self.scene = scene
        self._mirrored = mirrored
        self._file = _File(folder)
        size, lights = scene.lens.size, len(scene.lights)
        self._planes = [self._map(np.float32, *size) for _ in range(lights)]
        self._ambient = self._map(np.float32, *size)
        self._normals = self._map(np.float32, *size, 3)
        self._height = self._map(np.float64, *size)
        self._albedo = self._map(np.float32, *size, *([3] if scene.coloured else []))
        self._mask = self._map(np.bool_, *size)
        self._spheres = [self._map(np.bool_, *size) for _ in scene.spheres]
        # Eight pixels in a byte.
        self._shadows = [self._map(np.uint8, size[0], -(-size[1] // 8)) for _ in range(lights)]

    def _map(self, dtype: type[np.generic], *shape: int) -> StoredRows:
        rows = StoredRows(self._file, self._file.end, shape, np.dtype(dtype))
        self._file.end += rows.nbytes
        return rows

    @property
    def nbytes(self) -> int:
        """Size of the temporary file in bytes."""
        return self._file.end

    def put(self, part: Rendering) -> None:
        """Keep the rows of a rendering."""
        truth, first = part.truth, part.truth.top
        for kept, values in (
            *zip(self._planes, part.planes, strict=True),
            (self._ambient, part.ambient),
            (self._normals, truth.normals),
            (self._height, truth.height_mm),
            (self._albedo, truth.albedo),
            (self._mask, truth.mask),
            *zip(self._spheres, truth.sphere_masks, strict=True),
        ):
            kept.put(first, values)
        if truth.shadows is not None:
            for kept, shadow in zip(self._shadows, truth.shadows, strict=True):
                kept.put(first, np.packbits(shadow, axis=1))

    def plane(self, led: int | None) -> StoredRows:
        """Return the image of one LED alone, or of the ambient light for None; see `Rendering`."""
        if led is None:
            return self._ambient
        if not 0 <= led < len(self._planes):
            raise DataError(f"LED {led} is not in the scene, which has {len(self._planes)} LEDs")
        return self._planes[led]

    def rows(self, first: int, last: int) -> Rendering:
        """Return the rows from ``first`` to before ``last``; see `Rendering.rows`."""
        part, scene, width = slice(first, last), self.scene, self.scene.lens.size[1]
        table = scene.sphere_table
        spheres = [sphere[part] for sphere in self._spheres]
        truth = Truth(
            normals=self._normals[part],
            height_mm=self._height[part],
            albedo=self._albedo[part],
            mask=self._mask[part],
            sphere_masks=np.stack(spheres) if spheres else np.zeros((0, last - first, width), bool),
            sphere_centres_mm=table[:, :3],
            sphere_radii_mm=table[:, 3],
            highlights_px=self._mirrored.pixels,
            lights=scene.lights,
            lens=scene.lens,
            noise=scene.noise,
            electrons_per_us=scene.electrons_per_us,
            shadows=np.stack(
                [np.unpackbits(one[part], axis=1, count=width).view(bool) for one in self._shadows]
            ),
            top=first,
        )
        planes = np.stack([plane[part] for plane in self._planes])
        return Rendering(planes, self._ambient[part], truth, scene)

    def bands(self) -> Iterator[Rendering]:
        """Yield all rows, in bands of a few hundred megabytes at most."""
        height, width = self.scene.lens.size
        each = width * (_BYTES_PER_LIGHT * len(self.scene.lights) + _BYTES_PER_PIXEL)
        step = max(1, _BYTES_AT_WORK // each)
        for first in range(0, height, step):
            yield self.rows(first, min(first + step, height))

    def close(self) -> None:
        """Remove the temporary file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def render_stored(
    scene: Scene,
    folder: Path | str,
    *,
    memory_bytes: int = _MEMORY_BYTES,
    on_progress: Progress = no_progress,
) -> StoredRendering:
    """Render a scene in bands of rows, and keep the images in a temporary file.

    Values are equal to those of `render`. The rows that the blur of the lens needs around a band
    are rendered with it.

    Parameters
    ----------
    scene
        Scene to render.
    folder
        Folder of the temporary file, which has no name there and ends with the process.
    memory_bytes
        Memory that may be used.
    on_progress
        Receives the stage ``rendering``, one step per row.

    Returns
    -------
    StoredRendering
        The rendering; close it to remove the file.

    Raises
    ------
    DataError
        As `render`, or if ``memory_bytes`` is too little for one row.
    StorageError
        If the disk has too little space, or refuses the file.

    Examples
    --------
    >>> from simulator import render_stored, scene_named
    >>> with render_stored(scene_named("coin", width=64, height=52, leds=4), ".") as stored:
    ...     stored.plane(2)[10:12].shape, stored.rows(10, 12).truth.normals.shape
    ((2, 64), (2, 64, 3))
    """
    folder, renderer, height = Path(folder), RowRenderer(scene), scene.lens.size[0]
    step = _rows_of_band(renderer, memory_bytes)
    stored = StoredRendering(scene, folder, renderer.mirrored)
    try:
        free = shutil.disk_usage(folder).free
        if stored.nbytes > free:
            raise StorageError(
                f"{folder}: the rendering needs {stored.nbytes / 1e9:.1f} GB for a temporary file, "
                f"but {free / 1e9:.1f} GB are free: free space, or use a smaller image"
            )
        for first in range(0, height, step):
            last = min(first + step, height)
            stored.put(renderer.rows(first, last, lambda _: None))
            on_progress("rendering", last, height)
    except BaseException:
        stored.close()
        raise
    return stored


def _rows_of_band(renderer: RowRenderer, memory_bytes: int) -> int:
    lights, width = len(renderer.scene.lights), renderer.scene.lens.size[1]
    each = width * (_BYTES_PER_LIGHT * lights + _BYTES_PER_PIXEL) * len(set(renderer.colours[:2]))
    rows = (memory_bytes - _BYTES_AT_WORK) // each - 2 * renderer.margin
    if rows < 1:
        least = _BYTES_AT_WORK + each * (1 + 2 * renderer.margin)
        raise DataError(
            f"rendering {lights} images of {width} pixels a row needs at least "
            f"{math.ceil(least / 1e6)} MB of memory"
        )
    return min(rows, renderer.scene.lens.size[0])
