"""Linear images that are made from raw frames where they are read."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Lock
from typing import overload

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Source
from calibration._radiance.developer import Developer, FloatImage, Index, Pixels, brightest_sample
from calibration._radiance.linear_stack import threads_for
from rig import Notice, Progress, check_type, no_progress

_ROWS = 32
_ALL = slice(None)

Lights = slice | list[int] | npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class _RawImage:
    """The one frame of a light as it was read; it is made linear where it is used."""

    develop: Developer
    index: int
    pixels: Pixels

    def __getitem__(self, part: tuple[Index, Index]) -> FloatImage:
        return self.develop.part(self.index, self.pixels, part)


@dataclass(frozen=True, eq=False)
class RawStack:
    """Grey linear images of N lights, of which only the raw frames are kept.

    It is indexed like the ``(N, H, W)`` array `Stack.values`, and gives the same values: one image,
    ``stack[3]``, or a part of the images, ``stack[:, 100:200, 300:400]``, is an array; some of the
    lights, ``stack[::3]``, are a `RawStack`. Each access makes the values linear again. A stack of
    16-bit frames takes half of the memory of its values. Lights with several frames, and colour
    frames, are kept as linear grey values.

    Parameters
    ----------
    images
        For each light its image, or what gives parts of it.
    shape
        N, H, W.
    ids
        N names of the lights.
    brightest
        ``(H, W)`` float32, the brightest value of each pixel; 1 where one is saturated.
    peaks
        The brightest unsaturated sample of each image; NaN if all are saturated.
    camera
        The camera model; None if unknown.
    warnings
        As in `Stack`.
    """

    images: tuple[FloatImage | _RawImage, ...]
    shape: tuple[int, int, int]
    ids: tuple[str, ...]
    brightest: FloatImage
    peaks: tuple[float, ...]
    camera: CameraModel | None = None
    warnings: tuple[Notice, ...] = ()

    def __repr__(self) -> str:
        return f"RawStack({list(self.shape)}{', camera' if self.camera is not None else ''})"

    def __len__(self) -> int:
        return len(self.images)

    @overload
    def __getitem__(self, key: Lights) -> RawStack: ...
    @overload
    def __getitem__(
        self, key: int | tuple[int | Lights, Index] | tuple[int | Lights, Index, Index]
    ) -> FloatImage: ...
    def __getitem__(self, key: object) -> RawStack | FloatImage:
        lights, rows, columns = (
            (*key, _ALL, _ALL)[:3] if isinstance(key, tuple) else (key, _ALL, _ALL)
        )
        if isinstance(lights, int | np.integer):
            return self.images[lights][rows, columns]
        chosen = np.arange(len(self))[lights]
        if not isinstance(key, tuple):
            return self._of(chosen.tolist())
        first = self.images[chosen[0]][rows, columns]
        values: FloatImage = np.zeros((len(chosen), *first.shape), np.float32)
        values[0] = first
        for place, light in enumerate(chosen[1:], start=1):
            values[place] = self.images[light][rows, columns]
        return values

    def _of(self, lights: Sequence[int]) -> RawStack:
        return replace(
            self,
            images=tuple(self.images[i] for i in lights),
            ids=tuple(self.ids[i] for i in lights),
            shape=(len(lights), *self.shape[1:]),
            peaks=tuple(self.peaks[i] for i in lights),
        )


Images = FloatImage | RawStack
"""Linear grey images ``(N, H, W)``."""


def raw_stack(source: Source, *, on_progress: Progress = no_progress) -> RawStack:
    """Read a source and return its linear grey stack, kept as raw frames where possible.

    Use it instead of `linear_stack` where few parts of the images are needed, as for spheres.

    Parameters
    ----------
    source
        Source, as returned by `acquisition.read_source`.
    on_progress
        Receives the stage ``reading``, one step per light.

    Returns
    -------
    RawStack
        Images in the order of `Source.light_ids`, with the values of `linear_stack`.

    Raises
    ------
    DataError, EstimateError
        As `linear_stack`.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from calibration import raw_stack
    >>> for i in range(2):
    ...     write_png(f"card.{i}.png", np.full((4, 5), 65535 // (i + 2), np.uint16))
    >>> stack = raw_stack(read_source("."))
    >>> stack, stack[:, 0, 1:3].round(3)
    (RawStack([2, 4, 5]), array([[0.5  , 0.5  ],
           [0.333, 0.333]], dtype=float32))
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    develop = Developer(source, "gray")
    ids, size = source.light_ids, source.size
    brightest: FloatImage = np.zeros(size, np.float32)
    lock = Lock()

    def read(i: int) -> tuple[FloatImage | _RawImage, np.float32]:
        pixels = develop.raw(i)
        image = develop(i) if pixels is None else _RawImage(develop, i, pixels)
        largest = []
        for top in range(0, size[0], _ROWS):
            rows = slice(top, top + _ROWS)
            band = image[rows, _ALL]
            largest.append(brightest_sample(band))
            with lock:
                np.maximum(brightest[rows], band, out=brightest[rows])
        return image, np.float32(np.fmax.reduce(largest))

    images, samples = [], []
    with ThreadPoolExecutor(threads_for(4 * size[0] * size[1])) as pool:
        for image, largest in pool.map(read, range(len(ids))):
            images.append(image)
            samples.append(largest)
            on_progress("reading", len(images), len(ids))
    develop.check_usable(samples)
    np.nan_to_num(brightest, copy=False, nan=1.0)
    shape = (len(ids), *size)
    peaks = tuple(map(float, samples))
    return RawStack(tuple(images), shape, ids, brightest, peaks, source.camera, develop.notices)
