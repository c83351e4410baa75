"""Conversion of raw frames to linear radiance, one image per light."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Literal, Self, overload

import numpy as np

from acquisition import CameraModel, Lights, Source
from acquisition.source import RowReader
from calibration.radiance.developer import Developer, Index, Pixels, brightest_sample
from calibration.radiance.image_form import Channel
from calibration.radiance.stack_noise import StackNoise, pattern_from_row
from rig import Notice, Progress, check_type, no_progress
from rig.arrays import Bool, Float32, Intp, UInt8

_THREADS = 4
# Samples of the frames that are decoded at the same time, usually of 2 bytes.
_DECODED = 250_000_000
# Bytes of the values of a band, if the caller does not choose its rows.
_BAND = 64_000_000
# Bytes of the linear images that are computed at the same time; each needs several times as much.
_AT_ONCE = 200_000_000
# Rows of an image that are made at once. An even number keeps the colours of a mosaic in place.
_ROWS_AT_ONCE = 512
_ROWS_TOGETHER = 32
_ALL = slice(None)
Which = slice | list[int] | Intp


@dataclass(frozen=True, eq=False)
class _RawImage:
    """The one frame of a light as it was read; it is made linear where it is used."""

    develop: Developer
    index: int
    pixels: Pixels

    def __getitem__(self, part: tuple[Index, Index]) -> Float32:
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

    images: tuple[Float32 | _RawImage, ...]
    shape: tuple[int, int, int]
    ids: tuple[str, ...]
    brightest: Float32
    peaks: tuple[float, ...]
    camera: CameraModel | None = None
    warnings: tuple[Notice, ...] = ()

    def __repr__(self) -> str:
        return f"RawStack({list(self.shape)}{', camera' if self.camera is not None else ''})"

    def __len__(self) -> int:
        return len(self.images)

    @overload
    def __getitem__(self, key: Which) -> RawStack: ...
    @overload
    def __getitem__(
        self, key: int | tuple[int | Which, Index] | tuple[int | Which, Index, Index]
    ) -> Float32: ...
    def __getitem__(self, key: object) -> RawStack | Float32:
        lights, rows, columns = (
            (*key, _ALL, _ALL)[:3] if isinstance(key, tuple) else (key, _ALL, _ALL)
        )
        if isinstance(lights, int | np.integer):
            return self.images[lights][rows, columns]
        chosen = np.arange(len(self))[lights]
        if not isinstance(key, tuple):
            return self._of(chosen.tolist())
        first = self.images[chosen[0]][rows, columns]
        values: Float32 = np.zeros((len(chosen), *first.shape), np.float32)
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


Images = Float32 | RawStack
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
    brightest: Float32 = np.zeros(size, np.float32)
    lock = Lock()

    def read(i: int) -> tuple[Float32 | _RawImage, np.float32]:
        pixels = develop.raw(i)
        image = develop(i) if pixels is None else _RawImage(develop, i, pixels)
        largest = []
        for top in range(0, size[0], _ROWS_TOGETHER):
            rows = slice(top, top + _ROWS_TOGETHER)
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


@dataclass(frozen=True, eq=False)
class Stack:
    """Linear images of one object under N lights of intensity 1.

    Parameters
    ----------
    values
        ``(N, H, W)`` or ``(N, H, W, 3)`` float32 radiance, divided by the light's intensity and the
        relative exposure. 1 is the white level at the longest exposure under intensity 1; for float
        images it is the value 1. NaN where every exposure is saturated.
    ids
        N names of the lights.
    lights
        The N lights in this order, with their original intensities; None if unknown.
    mask
        ``(H, W)`` bool, the object; None if unknown.
    camera
        The camera model; None if unknown.
    warnings
        Dark or ambient frames that could not be used, or are missing; hot pixels; brackets that
        contradict their exposure times.
    noise
        Law of the temporal variance of the values; None if neither the recording nor its repeats
        determine it.
    hot_pixels
        ``(M, 2)`` row and column in the frames of pixels that the dark frames of some exposure time
        show as hot. Of brackets, a shorter one replaces them there; else their dark signal is
        subtracted, and their noise is larger than the law says.
    pattern
        Colour filters of the first 2 x 2 pixels of a stack of the channel ``mosaic``, row by row;
        None for other stacks.
    """

    values: Float32
    ids: tuple[str, ...]
    lights: Lights | None
    mask: Bool | None = None
    camera: CameraModel | None = None
    warnings: tuple[Notice, ...] = ()
    noise: StackNoise | None = None
    hot_pixels: Intp = field(default_factory=lambda: np.zeros((0, 2), np.intp))
    pattern: str | None = None

    def __repr__(self) -> str:
        parts = [f"{self.values.dtype}{list(self.values.shape)}"]
        parts += [name for name in ("lights", "mask", "camera") if getattr(self, name) is not None]
        return f"Stack({', '.join(parts)})"

    def take(self, indices: Sequence[int]) -> Stack:
        """Return the stack of the images with these indices, in this order."""
        pick = list(indices)
        return replace(
            self,
            values=self.values[pick],
            ids=tuple(self.ids[i] for i in pick),
            lights=None if self.lights is None else self.lights.take(pick),
            noise=None if self.noise is None else self.noise.take(pick),
        )

    def rows(self, first: int, last: int) -> Stack:
        """Return the stack of the rows from ``first`` to before ``last``.

        Values and mask are views. The camera, the law of the noise and the pattern are those of
        images that begin at this row.

        Raises
        ------
        ValueError
            If there are no such rows.
        """
        height, width = self.values.shape[1:3]
        if not 0 <= first < last <= height:
            raise ValueError(f"images of {height} rows have no rows from {first} to before {last}")
        pattern = self.pattern
        return replace(
            self,
            values=self.values[:, first:last],
            mask=None if self.mask is None else self.mask[first:last],
            camera=self.camera and self.camera.cropped(0, first, width, last - first),
            noise=None if self.noise is None else self.noise.rows(first, last),
            pattern=pattern and pattern_from_row(pattern, first),
        )


def linear_stack(
    source: Source,
    *,
    channel: Channel = "gray",
    on_progress: Progress = no_progress,
) -> Stack:
    """Read a source and return its linear stack.

    Every frame is made linear as `acquisition.source.Linearizer` does: black level, white level,
    transfer curve of the source. The mean of the ambient frames of the same exposure, or else of
    the dark frames, made linear in the same way, is subtracted, and the difference is divided by
    the relative exposure of the frame. Samples at the white level are saturated and left out; float
    images have no white level and keep their scale. Repeats are averaged. Brackets are merged with
    weights that are inversely proportional to their variances, or proportional to their exposure
    times if the noise is unknown; a bracket that one of at
    least 1/16 of its time can replace counts where the pixel is not hot in its dark frame, and
    neither the sample nor its surroundings are close to white.
    The result is divided by the flat field of the source, if it has one.
    Bayer frames are demosaiced bilinearly. Each channel is divided
    by the light's intensity, an image of one channel by the mean of the three intensities; gray is
    then ``.2989 R + .587 G + .114 B``. Frames of the role flat are not used. Images of a source
    with a `Source.reduction` are cropped and averaged last; a block with a saturated sample is left
    out.

    Parameters
    ----------
    source
        Source, as returned by `acquisition.read_source`.
    channel
        ``gray`` for one value per pixel, ``rgb`` for three, ``mosaic`` for the sites of a Bayer
        mosaic as they are, each divided by the intensity in its colour: a pixel has the same filter
        under all lights, so photometric stereo needs no demosaicing.
    on_progress
        Receives the stage ``reading``, one step per light.

    Returns
    -------
    Stack
        Images in the order of `Source.light_ids`.

    Raises
    ------
    DataError
        If a frame contains values that are not finite, has no exposure time although other frames
        have one, or has a colour filter that is not a Bayer pattern. The message names the file.
    EstimateError
        If all samples of all images are saturated or black.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights, read_source, write_png
    >>> from calibration import linear_stack
    >>> for i in range(2):
    ...     write_png(f"card.{i}.png", np.full((4, 5), 65535 // 2, np.uint16))
    >>> lights = Lights(directions=[[1, 0, 1], [0, 1, 1]], intensities=[1, 2])
    >>> stack = linear_stack(read_source(".", lights=lights))
    >>> stack, stack.values[:, 0, 0].round(3)
    (Stack(float32[2, 4, 5], lights), array([0.5 , 0.25], dtype=float32))
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    develop = Developer(source, channel)
    count = len(source.light_ids)
    used = develop.used(slice(0, source.size[0]))

    def used_at(i: int) -> UInt8 | None:
        return None if used is None else used[i]

    first = develop(0, used=used_at(0))
    values = np.zeros((count, *first.shape), np.float32)
    values[0] = first
    brightest = [brightest_sample(first)]
    threads = threads_for(first.nbytes)
    del first
    on_progress("reading", 1, count)

    def fill(i: int) -> np.float32:
        develop(i, out=values[i], used=used_at(i))
        return brightest_sample(values[i])

    with ThreadPoolExecutor(threads) as pool:
        for i, found in enumerate(pool.map(fill, range(1, count)), start=1):
            brightest.append(found)
            on_progress("reading", i + 1, count)
    develop.check_usable(brightest)
    return _stack(source, develop, values, used)


def _stack(source: Source, develop: Developer, values: Float32, used: UInt8 | None) -> Stack:
    return Stack(
        values,
        source.light_ids,
        source.lights,
        source.mask,
        source.camera,
        develop.notices,
        develop.noise(used),
        develop.hot_pixels,
        develop.pattern,
    )


def threads_for(image_bytes: int) -> int:
    """Return the number of threads for images whose linear values have this size."""
    return max(1, min(_THREADS, _AT_ONCE // image_bytes))


def linear_images(
    source: Source,
    ids: Sequence[str] | None = None,
    *,
    channel: Literal["gray", "rgb"] = "gray",
) -> Iterator[Float32]:
    """Yield the images of `linear_stack` one by one, with the next one in preparation.

    Parameters
    ----------
    source, channel
        As in `linear_stack`, as are the errors, except that black or saturated images are no error.
    ids
        Images to read, in this order; default: all of `Source.light_ids`.

    Yields
    ------
    FloatImage
        ``(H, W)`` or ``(H, W, 3)`` float32.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from calibration.radiance import linear_images
    >>> for i in range(2):
    ...     write_png(f"card.{i}.png", np.full((4, 5), 65535 // 2, np.uint16))
    >>> [image.shape for image in linear_images(read_source("."))]
    [(4, 5), (4, 5)]
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    develop = Developer(source, channel)
    places = {name: i for i, name in enumerate(source.light_ids)}
    wanted = [places[name] for name in (places if ids is None else ids)]
    with ThreadPoolExecutor(1) as pool:
        coming = [pool.submit(develop, i) for i in wanted[:1]]
        for after in [*wanted[1:], None]:
            image = coming.pop().result()
            if after is not None:
                coming.append(pool.submit(develop, after))
            yield image


def check_linear(name: str, values: object) -> None:
    """Refuse an array of integers where linear values are required.

    Raises
    ------
    TypeError
        If the array has a type that is not floating point.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.radiance import check_linear
    >>> check_linear("values", np.zeros((3, 4, 5), np.float32))
    >>> check_linear("values", np.zeros((3, 4, 5), np.uint8))
    Traceback (most recent call last):
        ...
    TypeError: values must be linear values of a floating-point type, not uint8: ...
    """
    kind = getattr(values, "dtype", None)
    if kind is not None and kind.kind != "f":
        raise TypeError(
            f"{name} must be linear values of a floating-point type, not {kind}: "
            "linear_stack(source) makes them from raw values"
        )


class BandedStack:
    """The stack of a source, of which only the rows in use are in memory; see `open_stack`.

    It has the attributes ids, lights, mask, camera, hot_pixels and pattern of `Stack`, and
    ``shape``: N, H, W, and 3 for images in colour.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from calibration import open_stack
    >>> for i in range(3):
    ...     write_png(f"card.{i}.png", np.full((6, 5), 20_000 * (i + 1), np.uint16))
    >>> with open_stack(read_source(".")) as stack:
    ...     means = [band.values.mean(axis=(1, 2)).round(2) for _, band in stack.bands(4)]
    >>> means[0], means[1]
    (array([0.31, 0.61, 0.92], dtype=float32), array([0.31, 0.61, 0.92], dtype=float32))
    """

    def __init__(
        self,
        source: Source,
        *,
        channel: Channel = "gray",
        on_progress: Progress = no_progress,
        reader: RowReader | None = None,
    ) -> None:
        self._source = source
        self._reader = RowReader() if reader is None else reader
        try:
            self._develop = Developer(source, channel, self._reader)
            of_lights = [frames for frames, _ in self._develop.tasks]
            threads = max(1, _DECODED // math.prod(source.frames[0].shape))
            with ThreadPoolExecutor(min(threads, _THREADS)) as pool:
                checked = pool.map(lambda frames: [*map(self._reader.check, frames)], of_lights)
                for done, _ in enumerate(checked, start=1):
                    on_progress("reading", done, len(of_lights))
            first = self._develop(0, slice(0, 1))
        except BaseException:
            self._reader.close()
            raise
        shape = (len(source.light_ids), source.size[0], *first.shape[1:])
        # The complete stack but for its values, which take no memory.
        self._form = _stack(source, self._develop, np.broadcast_to(np.float32(0), shape), None)
        self.shape: tuple[int, ...] = shape
        self.ids = self._form.ids
        self.lights = self._form.lights
        self.mask = self._form.mask
        self.camera = self._form.camera
        self.hot_pixels = self._form.hot_pixels
        self.pattern = self._form.pattern

    def __repr__(self) -> str:
        return f"BandedStack({list(self.shape)})"

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """As in `Stack`; brackets are compared in the rows that were made so far."""
        return self._develop.notices

    def rows(self, first: int, last: int) -> Stack:
        """Return the stack of the rows from ``first`` to before ``last``.

        It is equal to these rows of `linear_stack`; see `Stack.rows`.

        Raises
        ------
        ValueError
            If there are no such rows.
        DataError
            If a file was changed, or can no longer be read.
        """
        part = self._form.rows(first, last)
        rows = slice(first, last)
        used = self._develop.used(rows)
        values = np.zeros(part.values.shape, np.float32)

        def fill(i: int) -> None:
            of_one = None if used is None else used[i]
            self._develop(i, rows, values[i], of_one)

        with ThreadPoolExecutor(_THREADS) as pool:
            for _ in pool.map(fill, range(len(values))):
                pass
        noise = None if part.noise is None else replace(part.noise, used=used)
        return replace(part, values=values, noise=noise, warnings=self.warnings)

    def in_channel(self, channel: Channel) -> BandedStack:
        """Return the same images in another channel, without reading or keeping frames again.

        It is closed with this one.
        """
        return BandedStack(self._source, channel=channel, reader=self._reader)

    def image(self, index: int, rows: slice | None = None) -> Float32:
        """Return the image of one light, ``(H, W)`` or ``(H, W, 3)``, as in `linear_stack`.

        ``rows``, with start and stop, limits it to these rows.

        Raises
        ------
        DataError
            As `rows`.
        """
        wanted = slice(0, self.shape[1]) if rows is None else rows
        image = np.zeros((wanted.stop - wanted.start, *self.shape[2:]), np.float32)
        # In parts, because the frames and what is computed of them need far more memory.
        for first in range(wanted.start, wanted.stop, _ROWS_AT_ONCE):
            part = slice(first, min(first + _ROWS_AT_ONCE, wanted.stop))
            inside = slice(part.start - wanted.start, part.stop - wanted.start)
            self._develop(index, part, image[inside])
        return image

    def bands(self, rows: int | None = None) -> Iterator[tuple[slice, Stack]]:
        """Yield all rows in bands, from the top, with their stacks.

        Parameters
        ----------
        rows
            Rows of a band; default: as many as need 64 MB. The last band may have fewer.

        Raises
        ------
        ValueError
            If ``rows`` is not at least 1.
        DataError
            As `rows`.
        EstimateError
            After the last band, if all samples of all images are saturated or black.
        """
        height = self.shape[1]
        of_one = 4 * int(np.prod(self.shape)) // height
        step = max(1, _BAND // of_one) if rows is None else rows
        if step < 1:
            raise ValueError(f"a band has at least 1 row, not {rows}")
        brightest = []
        for first in range(0, height, step):
            last = min(first + step, height)
            band = self.rows(first, last)
            brightest.append(brightest_sample(band.values))
            yield slice(first, last), band
        self._develop.check_usable(brightest)

    def close(self) -> None:
        """Remove the decoded frames from the disk."""
        self._reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_stack(
    source: Source,
    *,
    channel: Channel = "gray",
    on_progress: Progress = no_progress,
) -> BandedStack:
    """Check the frames of a source and return its stack, whose values are made on request.

    Use it instead of `linear_stack` for recordings that do not fit into memory. In memory are the
    rows in use, the mask, and one image for each exposure time with dark or ambient frames.
    Uncompressed frames of sessions are read from their files. Others are decoded once, and kept in
    a temporary file until `BandedStack.close`.

    Parameters
    ----------
    source, channel
        As in `linear_stack`, as are the errors.
    on_progress
        Receives the stage ``reading``, one step per light, while the frames are checked.

    Returns
    -------
    BandedStack
        To be closed, for example by ``with``.

    Raises
    ------
    StorageError
        If the temporary file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from calibration import open_stack
    >>> for i in range(2):
    ...     write_png(f"card.{i}.png", np.full((400, 5), 65535 // (i + 2), np.uint16))
    >>> with open_stack(read_source(".")) as stack:
    ...     stack, stack.rows(100, 102).values[:, 0, :2].round(3)
    (BandedStack([2, 400, 5]), array([[0.5  , 0.5  ],
           [0.333, 0.333]], dtype=float32))
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    return BandedStack(source, channel=channel, on_progress=on_progress)
