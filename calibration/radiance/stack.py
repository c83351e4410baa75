"""Conversion of raw frames to linear radiance, one image per light."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Any, Literal, Self, cast

import numpy as np

from acquisition import CameraModel, Lights, Source
from acquisition.source import RowReader
from calibration.radiance.developer import Developer, Pixels, brightest_sample
from calibration.radiance.image_form import Channel
from calibration.radiance.stack_noise import StackNoise, pattern_from_row
from rig import Notice, Progress, check_type, no_progress
from rig.arrays import Bool, Float32, Float64, Intp, UInt8

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


@dataclass(frozen=True, eq=False)
class _FramesOfLight:
    """The frames of one light, which are made linear where the image is read.

    ``pixels`` are those of the only frame; None if the frames are read from their files.
    """

    develop: Developer
    index: int
    pixels: Pixels | None = None

    def __getitem__(self, part: tuple[Any, Any]) -> Float32:
        if self.pixels is not None:
            return self.develop.part(self.index, self.pixels, part)
        if not isinstance(part[0], slice) or part[0].step is not None:
            return np.asarray(self[_ALL, _ALL][part])
        first, last, _ = part[0].indices(self.develop.shape[1])
        image = np.zeros((last - first, *self.develop.shape[2:]), np.float32)
        # In parts, because the frames and what is computed of them need far more memory.
        for top in range(first, last, _ROWS_AT_ONCE):
            rows = slice(top, min(top + _ROWS_AT_ONCE, last))
            self.develop(self.index, rows, image[rows.start - first : rows.stop - first])
        return image[:, part[1]]


class LazyValues:
    """Values of a stack that are made from its frames where they are read, each time again.

    They are indexed like the array, and equal to it: one image, ``values[3]``, or a part of the
    images, ``values[:, 100:200, 300:400]``, is an array; some of the lights, ``values[::3]``, are
    `LazyValues`.

    Parameters
    ----------
    images
        For each light its image, or what gives parts of it.
    size
        Shape of an image.
    """

    dtype = np.dtype(np.float32)

    def __init__(self, images: Sequence[Float32 | _FramesOfLight], size: tuple[int, ...]) -> None:
        self._images = images
        self.shape = (len(images), *size)
        self.ndim = len(self.shape)

    def __len__(self) -> int:
        return len(self._images)

    def __getitem__(self, key: Any) -> Any:
        lights, rows, columns = (*(key if isinstance(key, tuple) else (key,)), _ALL, _ALL)[:3]
        if isinstance(lights, int | np.integer):
            return self._images[int(lights)][rows, columns]
        chosen = np.arange(len(self))[lights]
        if not isinstance(key, tuple):
            return LazyValues([self._images[i] for i in chosen], self.shape[1:])
        first = self._images[chosen[0]][rows, columns]
        values: Float32 = np.zeros((len(chosen), *first.shape), np.float32)
        values[0] = first
        for place, light in enumerate(chosen[1:], start=1):
            values[place] = self._images[light][rows, columns]
        return values


Images = Float32
"""Linear grey images ``(N, H, W)``, or `LazyValues`."""


@dataclass(frozen=True, eq=False)
class _MovedImage:
    """An image moved back, by linear interpolation; what was outside it repeats its border."""

    values: Images
    index: int
    by: Float64

    def __getitem__(self, part: tuple[Any, Any]) -> Float32:
        whole = np.floor(self.by).astype(np.intp)
        across, along = (np.float32(rest) for rest in self.by - whole)
        image = self._whole(part, *whole)
        if across:
            image = (1 - across) * image + across * self._whole(part, whole[0] + 1, whole[1])
        if along:
            below = replace(self, by=np.array([self.by[0], whole[1] + 1.0]))
            image = (1 - along) * image + along * below[part]
        return image

    def _whole(self, part: tuple[Any, Any], right: np.intp, down: np.intp) -> Float32:
        """Return a part of the image moved back by whole pixels."""
        sizes = self.values.shape[1:]
        places = [
            np.clip(np.arange(size)[one] + by, 0, size - 1)
            for size, one, by in zip(sizes, part, (down, right), strict=True)
        ]
        if not any(isinstance(one, slice) for one in part):  # single pixels
            return np.asarray(self.values[self.index, places[0], places[1]])
        rows, columns = (slice(int(at.min()), int(at.max()) + 1) for at in places)
        block = self.values[self.index, rows, columns]
        of_rows, of_columns = (at - at.min() for at in places)
        return np.asarray(block[np.ix_(of_rows, of_columns)])


def moved_values(values: Images, shifts_px: Float64) -> Images:
    """Return grey images ``(N, H, W)`` moved back, as `LazyValues`.

    They are interpolated linearly, which leaves no rings around highlights.

    Parameters
    ----------
    values
        Images, or `LazyValues`.
    shifts_px
        ``(N, 2)``: by how much each image is further right and down.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.radiance import moved_values
    >>> images = np.arange(8, dtype=np.float32).reshape(2, 1, 4)
    >>> moved_values(images, np.array([[0, 0], [1.5, 0]]))[1]
    array([[5.5, 6.5, 7. , 7. ]], dtype=float32)
    """
    moved = [_MovedImage(values, k, by) for k, by in enumerate(np.asarray(shifts_px, np.float64))]
    return cast(Images, LazyValues(cast(Any, moved), values.shape[1:]))


def raw_stack(source: Source, *, on_progress: Progress = no_progress) -> Stack:
    """Read a source and return its linear grey stack, kept as raw frames where possible.

    Use it instead of `linear_stack` where few parts of the images are needed, as for spheres. A
    stack of 16-bit frames takes half of the memory of its values. Lights with several frames, and
    colour frames, are kept as linear grey values.

    Parameters
    ----------
    source
        Source, as returned by `acquisition.read_source`.
    on_progress
        Receives the stage ``reading``, one step per light.

    Returns
    -------
    Stack
        Images in the order of `Source.light_ids`. Its values are `LazyValues`, equal to those of
        `linear_stack`; `Stack.brightest` and `Stack.peaks` are known.

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
    >>> stack, stack.values[:, 0, 1:3].round(3)
    (Stack(float32[2, 4, 5]), array([[0.5  , 0.5  ],
           [0.333, 0.333]], dtype=float32))
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    develop = Developer(source, "gray")
    ids, size = source.light_ids, source.size
    brightest: Float32 = np.zeros(size, np.float32)
    lock = Lock()

    def read(i: int) -> tuple[Float32 | _FramesOfLight, np.float32]:
        pixels = develop.raw(i)
        image = develop(i) if pixels is None else _FramesOfLight(develop, i, pixels)
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
    return replace(
        _stack(source, develop, LazyValues(images, size)),
        brightest=brightest,
        peaks=tuple(map(float, samples)),
    )


@dataclass(frozen=True, eq=False)
class Stack:
    """Linear images of one object under N lights of intensity 1.

    Close a stack from `open_stack`, for example by ``with``.

    Parameters
    ----------
    values
        ``(N, H, W)`` or ``(N, H, W, 3)`` float32 radiance, divided by the light's intensity and the
        relative exposure. 1 is the white level at the longest exposure under intensity 1; for float
        images it is the value 1. NaN where every exposure is saturated. Those of `raw_stack` and
        `open_stack` are `LazyValues`, made from the frames where they are read.
    ids
        N names of the lights.
    lights
        The N lights in this order, with their original intensities; None if unknown.
    mask
        ``(H, W)`` bool, the object; None if unknown.
    camera
        The camera model; None if unknown.
    notices
        Dark or ambient frames that could not be used, or are missing; hot pixels; brackets that
        contradict their exposure times. See `Stack.warnings`.
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
    brightest
        ``(H, W)`` float32, the brightest value of each pixel of a stack from `raw_stack`, 1 where
        one is saturated; empty for other stacks.
    peaks
        The brightest unsaturated sample of each image of such a stack; NaN if all are saturated.
    files
        The frames of a stack from `open_stack`; None for other stacks.

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

    values: Float32
    ids: tuple[str, ...]
    lights: Lights | None
    mask: Bool | None = None
    camera: CameraModel | None = None
    notices: tuple[Notice, ...] = ()
    noise: StackNoise | None = None
    hot_pixels: Intp = field(default_factory=lambda: np.zeros((0, 2), np.intp))
    pattern: str | None = None
    brightest: Float32 = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    peaks: tuple[float, ...] = ()
    files: StackFiles | None = None

    def __repr__(self) -> str:
        parts = [f"{self.values.dtype}{list(self.values.shape)}"]
        parts += [name for name in ("lights", "mask", "camera") if getattr(self, name) is not None]
        return f"Stack({', '.join(parts)})"

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """The notices; of an open stack, brackets are compared in the rows made so far."""
        return self.notices if self.files is None else self.files.develop.notices

    def take(self, indices: Sequence[int]) -> Stack:
        """Return the stack of the images with these indices, in this order."""
        pick = list(indices)
        return replace(
            self,
            values=self.values[pick],
            ids=tuple(self.ids[i] for i in pick),
            lights=None if self.lights is None else self.lights.take(pick),
            noise=None if self.noise is None else self.noise.take(pick),
            peaks=self.peaks and tuple(self.peaks[i] for i in pick),
        )

    def rows(self, first: int, last: int) -> Stack:
        """Return the stack of the rows from ``first`` to before ``last``.

        Values in memory and the mask are views. The camera, the law of the noise and the pattern
        are those of images that begin at this row.

        Raises
        ------
        ValueError
            If there are no such rows.
        DataError
            If a file of an open stack was changed, or can no longer be read.
        """
        height, width = self.values.shape[1:3]
        if not 0 <= first < last <= height:
            raise ValueError(f"images of {height} rows have no rows from {first} to before {last}")
        rows, pattern = slice(first, last), self.pattern
        noise = None if self.noise is None else self.noise.rows(first, last)
        if self.files is None:
            values = self.values[:, rows]
        else:
            values, used, _ = _made(self.files.develop, rows, _THREADS)
            noise = noise and replace(noise, used=used)
        return replace(
            self,
            values=values,
            mask=None if self.mask is None else self.mask[rows],
            camera=self.camera and self.camera.cropped(0, first, width, last - first),
            notices=self.warnings,
            noise=noise,
            pattern=pattern and pattern_from_row(pattern, first),
            files=None,
        )

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
            After the last band of an open stack, if all samples of all images are saturated or
            black.
        """
        height = self.values.shape[1]
        of_one = 4 * math.prod(self.values.shape) // height
        step = max(1, _BAND // of_one) if rows is None else rows
        if step < 1:
            raise ValueError(f"a band has at least 1 row, not {rows}")
        brightest = []
        for first in range(0, height, step):
            last = min(first + step, height)
            band = self.rows(first, last)
            brightest.append(brightest_sample(band.values))
            yield slice(first, last), band
        if self.files is not None:
            self.files.develop.check_usable(brightest)

    def close(self) -> None:
        """Remove the decoded frames of an open stack from the disk."""
        if self.files is not None:
            self.files.reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True, eq=False)
class StackFiles:
    """The frames of an open stack: what makes them linear, and what keeps and reads them."""

    source: Source
    develop: Developer
    reader: RowReader

    def in_channel(self, channel: Channel) -> Stack:
        """Return the same images in another channel, without reading or keeping frames again.

        It is closed with the stack.
        """
        return _opened(self.source, channel, self.reader)


def linear_stack(
    source: Source, *, channel: Channel = "gray", on_progress: Progress = no_progress
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
    then ``0.2989 R + 0.587 G + 0.114 B``. Frames of the role flat are not used. Images of a source
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
    threads = threads_for(4 * math.prod(develop.shape[1:]))
    values, used, brightest = _made(develop, slice(0, develop.shape[1]), threads, on_progress)
    develop.check_usable(brightest)
    return _stack(source, develop, values, used)


def _made(
    develop: Developer, rows: slice, threads: int, on_progress: Progress = no_progress
) -> tuple[Float32, UInt8 | None, list[np.float32]]:
    """Return rows of all images, brackets in use, and the brightest sample of each image."""
    count = len(develop.tasks)
    used = develop.used(rows)
    values = np.zeros((count, rows.stop - rows.start, *develop.shape[2:]), np.float32)

    def fill(i: int) -> np.float32:
        develop(i, rows, values[i], None if used is None else used[i])
        return brightest_sample(values[i])

    brightest = []
    with ThreadPoolExecutor(threads) as pool:
        for found in pool.map(fill, range(count)):
            brightest.append(found)
            on_progress("reading", len(brightest), count)
    return values, used, brightest


def _stack(
    source: Source, develop: Developer, values: Float32 | LazyValues, used: UInt8 | None = None
) -> Stack:
    return Stack(
        cast(Float32, values),
        source.light_ids,
        source.lights,
        source.mask,
        source.camera,
        develop.notices,
        develop.noise(used),
        develop.references.hot_pixels,
        develop.form.pattern,
    )


def threads_for(image_bytes: int) -> int:
    """Return the number of threads for images whose linear values have this size."""
    return max(1, min(_THREADS, _AT_ONCE // image_bytes))


def linear_images(
    source: Source, ids: Sequence[str] | None = None, *, channel: Literal["gray", "rgb"] = "gray"
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


def open_stack(
    source: Source, *, channel: Channel = "gray", on_progress: Progress = no_progress
) -> Stack:
    """Check the frames of a source and return its stack, whose values are made on request.

    Use it instead of `linear_stack` for recordings that do not fit into memory. In memory are the
    rows in use, the mask, and one image for each exposure time with dark or ambient frames.
    Uncompressed frames of sessions are read from their files. Others are decoded once, and kept in
    a temporary file until `Stack.close`.

    Parameters
    ----------
    source, channel
        As in `linear_stack`, as are the errors.
    on_progress
        Receives the stage ``reading``, one step per light, while the frames are checked.

    Returns
    -------
    Stack
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
    (Stack(float32[2, 400, 5]), array([[0.5  , 0.5  ],
           [0.333, 0.333]], dtype=float32))
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    return _opened(source, channel, RowReader(), on_progress)


def _opened(
    source: Source, channel: Channel, reader: RowReader, on_progress: Progress = no_progress
) -> Stack:
    try:
        develop = Developer(source, channel, reader)
        of_lights = [frames for frames, _ in develop.tasks]
        threads = max(1, _DECODED // math.prod(source.frames[0].shape))
        with ThreadPoolExecutor(min(threads, _THREADS)) as pool:
            checked = pool.map(lambda frames: [*map(reader.check, frames)], of_lights)
            for done, _ in enumerate(checked, start=1):
                on_progress("reading", done, len(of_lights))
        develop(0, slice(0, 1))  # whether the frames have the channel
    except BaseException:
        reader.close()
        raise
    frames = [_FramesOfLight(develop, i) for i in range(len(of_lights))]
    stack = _stack(source, develop, LazyValues(frames, develop.shape[1:]))
    return replace(stack, files=StackFiles(source, develop, reader))
