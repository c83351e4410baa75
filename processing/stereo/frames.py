"""Images in memory as the compiled solvers read them: any type and strides, one pixel at a time."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from rig import in_threads
from rig.arrays import AnyArray, Float32, Int64, Intp
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

Flat = tuple[AnyArray, ...]

# Pixels that are solved together. Their samples fit into the second-level cache.
TILE = 2048
_KINDS = (np.uint8, np.uint16, np.float32)


class Frames:
    """N images of H x W pixels, whose samples are converted where they are used.

    A sample becomes ``(raw - dark) * gain``, or NaN from a limit on. The images are read in place:
    they may be a region of larger images, or have gaps between rows. Only arrays whose neighbours
    in a row are not neighbours in memory are copied.

    Parameters
    ----------
    images
        ``(N, H, W)``, numbers.
    gain
        ``(N,)`` factor of each image; default: 1.
    dark
        One number for all pixels, or ``(H, W)``.
    limit
        Raw samples from this value on are saturated.
    """

    def __init__(
        self,
        images: AnyArray,
        *,
        gain: npt.ArrayLike | None = None,
        dark: npt.ArrayLike = 0.0,
        limit: float = np.inf,
    ) -> None:
        count, self.height, self.width = images.shape
        if images.dtype not in _KINDS:
            images = images.astype(np.float32)
        size = images.itemsize
        regular = all(step >= 0 and step % size == 0 for step in images.strides)
        neighbours = self.width == 1 or images.strides[2] == size
        if not (regular and neighbours and images.dtype.isnative):
            images = np.array(images, images.dtype.newbyteorder("="), order="C")
        self.image_step, self.row_step = (step // size for step in images.strides[:2])
        extent = sum((n - 1) * step for n, step in zip(images.shape, images.strides, strict=True))
        flat = np.lib.stride_tricks.as_strided(
            images, (extent // size + 1 if images.size else 0,), (size,), writeable=False
        )
        # One array per type, of which one is used: the solvers are compiled once.
        self.flat: Flat = tuple(
            flat
            if flat.dtype == kind
            else np.lib.stride_tricks.as_strided(np.zeros(0, kind), writeable=False)
            for kind in _KINDS
        )
        self._images = images  # keeps the memory
        self.gain = np.ones(count, np.float32)
        if gain is not None:
            self.gain[:] = gain
        self.dark = np.ascontiguousarray(np.atleast_2d(np.asarray(dark, np.float32)))
        self.limit = np.float32(limit)
        # Whether the samples are those of the memory, without gaps between rows.
        self.in_place = bool(
            self.row_step == self.width
            and images.dtype == np.float32
            and (self.gain == 1).all()
            and not self.dark.any()
            and limit == np.inf
        )

    def __len__(self) -> int:
        return len(self.gain)

    def of_pixels(self, pixels: Intp) -> Float32:
        """Return the samples ``(P, N)`` of some pixels, indices into the flat image."""
        values = np.zeros((len(pixels), len(self)), np.float32)
        in_threads(
            _gather, -(-len(pixels) // 256), self.flat, self.image_step, self.row_step, self.width,
            self.gain, self.dark, self.limit, np.ascontiguousarray(pixels), values,
        )  # fmt: skip
        return values


@numba.njit(nogil=True, cache=True)
def _gather(
    first: int, end: int,
    flat: Flat, image_step: int, row_step: int, width: int,
    gain: Float32, dark: Float32, limit: np.float32, pixels: Int64, values: Float32,
) -> None:  # fmt: skip
    at, shift = np.zeros(256, np.int64), np.zeros(256, np.float32)
    for block in range(first, end):
        begin = 256 * block
        count = min(256, len(pixels) - begin)
        for k in range(count):
            row, column = divmod(pixels[begin + k], width)
            at[k] = row * row_step + column
            shift[k] = dark[0, 0] if dark.size == 1 else dark[row, column]
        for i in range(len(gain)):
            out = values[begin : begin + count, i]
            if len(flat[0]):
                _gather_image(flat[0][i * image_step :], at, shift, gain[i], limit, out)
            elif len(flat[1]):
                _gather_image(flat[1][i * image_step :], at, shift, gain[i], limit, out)
            else:
                _gather_image(flat[2][i * image_step :], at, shift, gain[i], limit, out)


@numba.njit(**PART)
def _gather_image(
    image: AnyArray, at: Int64, shift: Float32, gain: np.float32, limit: np.float32, out: Float32
) -> None:
    for k in range(len(out)):
        raw = np.float32(image[at[k]])
        out[k] = (raw - shift[k]) * gain if raw < limit else np.float32(np.nan)


@numba.njit(**PART)
def load_tile(
    flat: Flat, image_step: int, row_step: int, width: int,
    gain: Float32, dark: Float32, limit: np.float32, first: int, count: int, tile: Float32,
) -> None:  # fmt: skip
    """Write the samples of ``count`` consecutive pixels from ``first`` on into ``(N, TILE)``."""
    shift = np.zeros(TILE, np.float32)
    row, column = first // width, first % width
    done = 0
    while done < count:
        n = min(count - done, width - column)
        for k in range(n):
            shift[k] = dark[0, 0] if dark.size == 1 else dark[row, column + k]
        for i in range(len(gain)):
            begin = i * image_step + row * row_step + column
            out = tile[i, done : done + n]
            # Slices, because an index with an offset would not vectorise.
            if len(flat[0]):
                _load_row(flat[0][begin : begin + n], shift, gain[i], limit, out)
            elif len(flat[1]):
                _load_row(flat[1][begin : begin + n], shift, gain[i], limit, out)
            else:
                _load_row(flat[2][begin : begin + n], shift, gain[i], limit, out)
        done += n
        row, column = row + 1, 0


@numba.njit(**PART)
def _load_row(
    raw: AnyArray, dark: Float32, gain: np.float32, limit: np.float32, out: Float32
) -> None:
    for k in range(len(out)):
        value = np.float32(raw[k])
        out[k] = (value - dark[k]) * gain if value < limit else np.float32(np.nan)
