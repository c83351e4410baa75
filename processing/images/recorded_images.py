"""The images of a recording: single ones to examine them, bands of rows to solve them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration import Stack, StackNoise
from calibration.radiance import luma
from processing.images.reflected_light import ReflectedLight
from processing.images.viewing_rays import SurfacePoints
from rig import Notice
from rig.arrays import Bool, Float32, Float64, Intp

# Pixels of a sample, and rows that are next to each other in it. An even number, so that each group
# of rows of a mosaic begins with the colours of the first row.
_SAMPLE = 500_000
_GROUP = 8
# Bytes of the values of a band.
_BAND = 128_000_000


@dataclass(frozen=True, eq=False)
class RowSample:
    """Some rows of all images, as images of their own.

    Parameters
    ----------
    rows
        ``(R,)`` their numbers.
    values
        ``(N, R, W)`` linear radiance, or ``(N, R, W, 3)``.
    mask
        ``(R, W)`` bool, the object.
    noise
        The law of their noise; None if it is unknown.
    """

    rows: Intp
    values: Float32
    mask: Bool
    noise: StackNoise | None

    def of(self, points: SurfacePoints | None) -> Float64 | None:
        """Return the points of these rows in mm."""
        return None if points is None else points.of(self.rows)


@dataclass(frozen=True, eq=False)
class Band:
    """Rows of all images, with the rows around them that a filter needs.

    Parameters
    ----------
    rows
        The rows.
    inside
        Where the rows are in ``sample``.
    sample
        The same and those around them.
    """

    rows: slice
    inside: slice
    sample: RowSample


class RecordedImages:
    """N images, in memory or on disk.

    As a sequence they are complete images ``(H, W)`` in gray, the luma of those in colour; those on
    disk are read when they are used. Values are equal for both kinds of stack.

    Parameters
    ----------
    stack
        The images.
    kept
        Indices of those in use; default: all.
    constant
        ``(H, W)``, or ``(H, W, 3)`` of images in colour: light that is in all images, and is
        subtracted; default: none.
    shares
        ``(M,)`` factors of it for all images of the stack.
    factors
        ``(M,)`` by which all images of the stack are then divided; default: 1.
    reflected
        Light in all images of the stack that is then subtracted; default: none.
    """

    def __init__(
        self,
        stack: Stack,
        kept: Sequence[int] | None = None,
        constant: Float32 | None = None,
        shares: Float32 | None = None,
        factors: Float32 | None = None,
        reflected: ReflectedLight | None = None,
    ) -> None:
        self._stack, self._constant, self._reflected = stack, constant, reflected
        self._shares = np.ones(len(stack.ids), np.float32) if shares is None else shares
        self._factors = factors
        self._kept = list(range(len(stack.ids)) if kept is None else kept)
        self.ids = tuple(stack.ids[i] for i in self._kept)
        shape = stack.values.shape
        self.size = (shape[1], shape[2])
        self.in_colour = len(shape) > 3

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """Notices about the images; of those on disk, about what was read so far."""
        return self._stack.warnings

    def __len__(self) -> int:
        return len(self._kept)

    def __getitem__(self, index: int) -> Float32:
        image = self._stack.values[self._kept[index]]
        if self._constant is not None:
            image = image - self._shares[self._kept[index]] * self._constant
        if self._factors is not None:
            image = image / self._factors[self._kept[index]]
        if self._reflected is not None:
            image = image - self._reflected.of(index)
        return luma(image) if self.in_colour else image

    def __iter__(self) -> Iterator[Float32]:
        return (self[i] for i in range(len(self)))

    def take(self, indices: Sequence[int]) -> RecordedImages:
        """Return the images with these indices."""
        kept = [self._kept[i] for i in indices]
        reflected = None if self._reflected is None else self._reflected.take(indices)
        return RecordedImages(
            self._stack, kept, self._constant, self._shares, self._factors, reflected
        )

    def without(self, constant: Float32, shares: Float64) -> RecordedImages:
        """Return the images without a constant light, of which each has its share ``(N,)``."""
        of_stack = np.zeros(len(self._stack.ids), np.float32)
        of_stack[self._kept] = shares
        return RecordedImages(
            self._stack, self._kept, constant, of_stack, self._factors, self._reflected
        )

    def without_reflected(self, light: ReflectedLight) -> RecordedImages:
        """Return the images without light that the object reflects onto itself."""
        return RecordedImages(
            self._stack, self._kept, self._constant, self._shares, self._factors, light
        )

    def divided(self, factors: Float64) -> RecordedImages:
        """Return the images divided by factors ``(N,)``."""
        of_stack = np.ones(len(self._stack.ids), np.float32)
        of_stack[self._kept] = factors
        before = 1 if self._factors is None else self._factors
        return RecordedImages(
            self._stack,
            self._kept,
            self._constant,
            self._shares,
            of_stack * before,
            self._reflected,
        )

    def stack(self, *, colour: bool = False) -> Stack:
        """Return all images, in memory, in gray or as they are."""
        return self._rows(0, self.size[0], colour=colour)

    def _rows(self, first: int, last: int, *, colour: bool) -> Stack:
        part = self._stack.rows(first, last)
        if len(self) < len(part.ids):
            part = part.take(self._kept)
        if self._constant is not None:
            shares = self._shares[self._kept].reshape(-1, *[1] * (part.values.ndim - 1))
            part = replace(part, values=part.values - shares * self._constant[first:last])
        if self._factors is not None:
            part = _divided(part, self._factors[self._kept])
        if self._reflected is not None:
            rows = slice(first, last)
            lights = [self._reflected.of(index, rows) for index in range(len(self))]
            part = replace(part, values=part.values - np.stack(lights))
        return replace(part, values=luma(part.values)) if self.in_colour and not colour else part

    def bands(
        self,
        mask: Bool,
        around: int,
        rows: int | None = None,
        part: slice = slice(None),
        *,
        colour: bool = False,
    ) -> Iterator[Band]:
        """Yield the rows with pixels of the mask, in bands of at most ``rows``, 128 MB by default.

        ``around`` is the number of further rows above and below, as far as there are any. Only
        rows of ``part`` are in bands, which are gray, or in ``colour``.
        """
        height, width = self.size
        of_row = 4 * len(self) * width * (3 if self.in_colour else 1)
        step = rows or max(1, _BAND // of_row)
        inside = np.arange(height)[part][mask[part].any(axis=1)]
        end = int(inside[-1]) + 1 if len(inside) else 0
        for first in range(int(inside[0]) if len(inside) else 0, end, step):
            last = min(first + step, end)
            if mask[first:last].any():
                above, below = max(first - around, 0), min(last + around, height)
                inner = slice(first - above, last - above)
                stack = self._rows(above, below, colour=colour)
                numbers = np.arange(above, below)
                sample = RowSample(numbers, stack.values, mask[above:below], stack.noise)
                yield Band(slice(first, last), inner, sample)

    def sample(self, mask: Bool, *, colour: bool = False) -> RowSample:
        """Return rows with pixels of the mask: all of a small object, else groups of 8 rows.

        They do not depend on bands.
        """
        inside = np.flatnonzero(mask.any(axis=1))
        first, last = int(inside[0]) // 2 * 2, int(inside[-1]) + 1
        groups = max(1, _SAMPLE // (_GROUP * self.size[1]))
        if last - first <= groups * _GROUP:
            parts = [(first, last)]
        else:
            starts = first + np.linspace(0, last - first - _GROUP, groups).astype(int) // 2 * 2
            parts = [(int(start), int(start) + _GROUP) for start in starts]
        stacks = [self._rows(*part, colour=colour) for part in parts]
        rows = np.concatenate([np.arange(*part) for part in parts])
        values = stacks[0].values
        if len(stacks) > 1:
            values = np.concatenate([stack.values for stack in stacks], axis=1)
        return RowSample(rows, values, mask[rows], _joined([stack.noise for stack in stacks]))


# The same images as an array.
Images = Float32 | RecordedImages


def _divided(stack: Stack, factors: Float32) -> Stack:
    values = stack.values / factors.reshape(-1, *[1] * (stack.values.ndim - 1))
    noise = stack.noise
    if noise is not None:
        noise = replace(noise, intensities=noise.intensities * factors[:, None])
    return replace(stack, values=values, noise=noise)


def _joined(laws: Sequence[StackNoise | None]) -> StackNoise | None:
    """Return the law of rows below each other, each of which begins with an even row."""
    known = [law for law in laws if law is not None]
    if not known:
        return None
    used = [law.used for law in known if law.used is not None]
    response = [law.response for law in known if law.response is not None]
    return replace(
        known[0],
        used=np.concatenate(used, axis=1) if used else None,
        response=np.concatenate(response) if response else None,
    )
