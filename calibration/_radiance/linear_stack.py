"""Conversion of raw frames to linear radiance, one image per light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Lights, Source
from calibration._radiance.developer import Developer, FloatImage
from calibration._radiance.stack_noise import StackNoise, pattern_from_row
from calibration._radiance.stack_tasks import (
    Channel,
    brightest_sample,
    check_usable,
    frames_of_lights,
    lit_frames,
    threads_for,
)
from rig import Notice, Progress, check_type, no_progress


def _no_pixels() -> npt.NDArray[np.intp]:
    return np.zeros((0, 2), np.intp)


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

    values: FloatImage
    ids: tuple[str, ...]
    lights: Lights | None
    mask: npt.NDArray[np.bool_] | None = None
    camera: CameraModel | None = None
    warnings: tuple[Notice, ...] = ()
    noise: StackNoise | None = None
    hot_pixels: npt.NDArray[np.intp] = field(default_factory=_no_pixels)
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

    Every frame is made linear as `acquisition.Linearizer` does: black level, white level, transfer
    curve of the source. The mean of the ambient frames of the same exposure, or else of the dark
    frames, made linear in the same way, is subtracted, and the difference is divided by the
    relative exposure of the frame. Samples at the white level are saturated and left out; float
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
    lit = lit_frames(source)
    ids, lights = source.light_ids, source.lights
    develop = Developer(source, lit, channel)
    tasks = frames_of_lights(source, lit)
    used = develop.used(tasks, slice(0, source.size[0]))

    def used_at(i: int) -> npt.NDArray[np.uint8] | None:
        return None if used is None else used[i]

    first = develop(*tasks[0], used=used_at(0))
    values = np.zeros((len(ids), *first.shape), np.float32)
    values[0] = first
    brightest = [brightest_sample(first)]
    threads = threads_for(first.nbytes)
    del first
    on_progress("reading", 1, len(ids))

    def fill(i: int) -> np.float32:
        develop(*tasks[i], out=values[i], used=used_at(i))
        return brightest_sample(values[i])

    with ThreadPoolExecutor(threads) as pool:
        for i, found in enumerate(pool.map(fill, range(1, len(ids))), start=1):
            brightest.append(found)
            on_progress("reading", i + 1, len(ids))
    check_usable(brightest, ids, source, develop.reference_level)
    return Stack(
        values,
        ids,
        lights,
        source.mask,
        source.camera,
        develop.notices,
        develop.noise(tasks, used),
        develop.hot_pixels,
        develop.pattern,
    )


def linear_images(
    source: Source,
    ids: Sequence[str] | None = None,
    *,
    channel: Literal["gray", "rgb"] = "gray",
) -> Iterator[FloatImage]:
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
    >>> from calibration import linear_images
    >>> for i in range(2):
    ...     write_png(f"card.{i}.png", np.full((4, 5), 65535 // 2, np.uint16))
    >>> [image.shape for image in linear_images(read_source("."))]
    [(4, 5), (4, 5)]
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    lit = lit_frames(source)
    develop = Developer(source, lit, channel)
    tasks = dict(zip(source.light_ids, frames_of_lights(source, lit), strict=True))
    wanted = [tasks[name] for name in (source.light_ids if ids is None else ids)]
    with ThreadPoolExecutor(1) as pool:
        coming = [pool.submit(develop, *task) for task in wanted[:1]]
        for after in [*wanted[1:], None]:
            image = coming.pop().result()
            if after is not None:
                coming.append(pool.submit(develop, *after))
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
    >>> from calibration import check_linear
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
