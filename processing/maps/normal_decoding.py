"""Pixels of an image to unit normals, band by band."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import numba
import numpy as np

from acquisition import DataError
from acquisition.files import BandFile, rows_in_bands
from processing.maps.normal_encoding import NormalEncoding, normal_encoding
from processing.maps.normal_map import directions
from rig import Notice, in_threads, pluralize
from rig.arrays import AnyArray, Bool, Float32, UInt16

Green = Literal["up", "down"]

# Larger components cannot belong to a unit vector, and their squares would overflow.
_LONGEST = 1000.0
# Normals with a smaller z hardly face the camera. Of 66 maps, at most 0.7 % do not (an owl,
# which also shows its back); if another component is stored as z, nearly half of them.
_LEAST_Z, _MOST_AWAY = 0.02, 0.1
# The channel in which z is stored: noise and quantisation may make a few of its values negative.
_FEW = 0.02
_CHANNELS = ("red", "green")
# Decoded vectors differ from unit length by up to 0.3 in JPEG files. Black and white backgrounds
# decode to a length of 1.73, mid-grey ones to 0.
_LENGTH_TOLERANCE = 0.5
_BACKGROUND_LENGTH = 1.7
# What rounding of the components to float32 changes the length by, at most.
_ROUNDING = 2.5e-7
# An image is rejected unless most of its vectors are this close to unit length. One third of the
# pixels of a random image are, and 98 % of those of an 8-bit JPEG of normals.
_CLOSE = 0.1
# Vectors that decide how a map is encoded.
_MOST_COMPARED = 1 << 18
_MOST_DECODED = 1 << 16
_BAND_BYTES = 1 << 24


class _Directions:
    """Where the normals of a map point, collected band by band."""

    def __init__(self) -> None:
        self._sum, self._negative = np.zeros(3), np.zeros(3, np.int64)
        self._away = self._count = 0

    def add(self, normals: Float32, known: Bool) -> None:
        """Count more normals: ``(h, W, 3)`` unit vectors, 0 where ``(h, W)`` `known` is false."""
        for k in range(3):
            self._sum[k] += normals[..., k].sum(dtype=np.float64)
            self._negative[k] += np.count_nonzero(normals[..., k] < 0)
        self._away += int(np.count_nonzero((normals[..., 2] < _LEAST_Z) & known))
        self._count += int(np.count_nonzero(known))

    def doubts(self, where: str) -> list[Notice]:
        """Return a notice if normals face away from the camera, or z is in another channel.

        Toward the camera, z is positive, and x and y have both signs. If another channel than blue
        is never negative and larger, and blue often is, that channel holds z. A map of a tilted
        plane may have positive x and z; it shows nothing if its channels are swapped.
        """
        away = self._away / max(self._count, 1)
        stored = [
            channel
            for channel, total, negative in zip(
                _CHANNELS, self._sum[:2], self._negative[:2], strict=True
            )
            if negative <= _FEW * self._count and total > abs(self._sum[2])
        ]
        if away > _MOST_AWAY and len(stored) == 1:
            text = (
                f"{away:.0%} of the normals do not face the camera, but all have a positive "
                f"{stored[0]} channel: {stored[0]} and blue seem to be swapped"
                f"{' (BGR)' if stored[0] == 'red' else ''}: the channels must be x, y and z"
            )
            return [Notice("normals-channels-swapped", text, where)]
        if self._sum[2] < 0:
            text = "most normals face away from the camera: check the sign of z"
            return [Notice("normals-face-away", text, where)]
        return []


def _pixel_doubts(where: str, finite: Bool | None, mask: Bool | None, known: Bool) -> list[Notice]:
    """Return notices about pixels without a normal.

    Parameters
    ----------
    where
        The file, for messages.
    finite
        ``(H, W)`` bool, pixels whose components are finite; None for integers. It is overwritten.
    mask
        ``(H, W)`` bool, pixels that should have a normal, or None.
    known
        ``(H, W)`` bool, pixels that have one.
    """
    warnings = []
    not_finite = 0
    if finite is not None:
        lacking = np.logical_not(finite, out=finite)
        if mask is not None:
            lacking &= mask
        not_finite = int(np.count_nonzero(lacking))
    if not_finite:
        words = (
            "pixel has a NaN or infinite vector and is",
            "pixels have a NaN or infinite vector and are",
        )
        text = f"{pluralize(not_finite, *words)} left out of the mask"
        warnings.append(Notice("normals-not-finite", text, where))
    lost = 0 if mask is None else int(np.count_nonzero(mask) - np.count_nonzero(known))
    if lost:
        words = (
            "pixel of the mask has no unit vector and is",
            "pixels of the mask have no unit vector and are",
        )
        text = f"{pluralize(lost, *words)} left out"
        warnings.append(Notice("normals-not-unit", text, where))
    return warnings


class PixelRows(Protocol):
    """An image with or without an alpha channel, of which rows are read from the top downwards."""

    @property
    def shape(self) -> tuple[int, ...]:
        """``(H, W, 3)``."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the samples."""

    def with_alpha(self, rows: slice, /) -> tuple[AnyArray, AnyArray | None]:
        """Return rows of the colours, and of alpha if there is one."""


@dataclass(frozen=True, eq=False)
class PixelsInMemory:
    """An image that was read at once."""

    pixels: AnyArray
    alpha: AnyArray | None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the colours."""
        return self.pixels.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the samples."""
        return self.pixels.dtype

    def with_alpha(self, rows: slice) -> tuple[AnyArray, AnyArray | None]:
        """Return rows of the colours, and of alpha if there is one."""
        return self.pixels[rows], None if self.alpha is None else self.alpha[rows]


class GivenMask(NamedTuple):
    """A mask from a file."""

    inside: Bool
    file: Path


def decode_normals(
    file: Path,
    pixels: PixelRows,
    given: GivenMask | None,
    green: Green,
    normals: Float32 | BandFile,
) -> tuple[Bool, list[Notice]]:
    """Write the normals of an image; return where they are known, and notices.

    Parameters
    ----------
    file
        The image, for messages.
    pixels
        Its pixels.
    given
        The mask, if there is one.
    green
        Direction of the green channel.
    normals
        ``(H, W, 3)`` float32, written: unit vectors, 0 where a normal is not known. An array of
        float32 may be that of the pixels.

    Raises
    ------
    DataError
        As `read_normals`, except for an empty mask.
    """
    height, width = pixels.shape[:2]
    bands = rows_in_bands(height, 12 * width, _BAND_BYTES)
    painted, finite, alpha = _stored(pixels, normals, bands)
    integers = finite is None
    encoded, doubled, lacks_z = integers, False, False
    if not integers:
        some = _some(normals, painted, bands)
        # Encoded values are not negative. Vectors without z are not encoded.
        signed = bool((some < 0).any())
        lacks_z = signed and not some[:, 2].any()
        encoded = doubled = not lacks_z and (
            _distance_to_unit(some) > _distance_to_unit(some * 2 - 1)
            or (not signed and _were_colours(some))
        )
    notes: list[Notice] = []
    mask, share = None if given is None else given.inside, None
    if alpha is not None:
        opacity = _share(alpha)
        if encoded and _is_premultiplied(normals, opacity, bands, doubled=doubled):
            share = opacity
        if given is None:
            mask, note = _mask_of_alpha(file, opacity)
            notes.append(note)
        elif not np.array_equal(given.inside, opacity > 0.5):
            text = f"the alpha channel is ignored, the mask is {given.file}"
            notes.append(Notice("alpha-ignored", text, str(file), "info"))
    encoding = NormalEncoding(lacks_z=lacks_z)
    if encoded:
        chosen = np.ones((height, width), np.bool_) if mask is None else mask
        if share is not None:
            chosen = chosen & (share == 1)
        some = _some(normals, chosen, bands)
        some = some[:: 1 + len(some) // _MOST_DECODED]
        encoding = normal_encoding(some * 2 - 1 if doubled else some)
    notes += encoding.notices(str(file))
    known = np.zeros((height, width), np.bool_)
    close = count = 0
    seen = _Directions()
    for rows in bands:
        vectors = np.ascontiguousarray(normals[rows])
        if doubled:
            vectors = vectors * 2 - 1
        if share is not None:
            _divide(vectors, share[rows])
        encoding.apply(vectors)
        if green == "down":
            vectors[..., 1] *= -1
        length = np.zeros(vectors.shape[:2], np.float32)
        _lengths(vectors, length)
        drawn = (length > _LENGTH_TOLERANCE) & (length < _BACKGROUND_LENGTH)
        off = np.abs(np.subtract(length, 1, out=length), out=length)
        # Alpha often includes background: some programs erase only pixels of the object.
        candidates = drawn
        if mask is not None:
            candidates = mask[rows] if given is not None else mask[rows] & drawn
        close += int(np.count_nonzero(candidates & (off < _CLOSE)))
        count += int(np.count_nonzero(candidates))
        unit = np.zeros(vectors.shape, np.float32)
        inside = (off < _LENGTH_TOLERANCE) & candidates
        in_threads(directions, len(unit), vectors, inside, unit, known[rows])
        if not integers:
            # Unit vectors as floats can hold them are returned as they are.
            np.copyto(unit, vectors, where=(known[rows] & (off < _ROUNDING))[..., None])
        normals[rows] = unit
        seen.add(unit, known[rows])
    if 2 * close <= count:
        decoded = f"{close} of {count} pixels decode" if count else "no pixel decodes"
        reason = "the mask belongs to another image"
        if given is None and mask is not None:
            reason = "alpha holds x instead of a mask (DXT5nm): save x, y, z as red, green, blue"
        raise DataError(
            f"{file}: {decoded} to a unit vector: this is not a normal map, or {reason}"
        )
    if pixels.dtype == np.uint8:
        notes.append(_eight_bits(file))
    notes += _pixel_doubts(str(file), finite, mask, known)
    return known, [*notes, *seen.doubts(str(file))]


def _stored(
    pixels: PixelRows, normals: Float32 | BandFile, bands: list[slice]
) -> tuple[Bool, Bool | None, AnyArray | None]:
    """Write the values of an image: integers are decoded, floats are as they are.

    Returns
    -------
    drawn
        ``(H, W)`` bool, pixels that are not 0.
    finite
        ``(H, W)`` bool, pixels whose components are finite; None for integers.
    alpha
        ``(H, W)`` alpha channel of the file, or None.
    """
    size, integers = pixels.shape[:2], np.issubdtype(pixels.dtype, np.integer)
    most = np.iinfo(pixels.dtype).max if integers else 0
    # A table, because the samples of an image in float64 take much memory.
    table = (np.arange(most + 1) * (2.0 / max(most, 1)) - 1.0).astype(np.float32)
    drawn = np.zeros(size, np.bool_)
    finite = None if integers else np.zeros(size, np.bool_)
    alpha: AnyArray | None = None
    for rows in bands:
        part, opacity = pixels.with_alpha(rows)
        if opacity is not None:
            alpha = np.zeros(size, opacity.dtype) if alpha is None else alpha
            alpha[rows] = opacity
        if finite is None:
            normals[rows] = table[part]
            continue
        x, y, z = (np.isfinite(part[..., k]) for k in range(3))
        finite[rows] = x & y & z
        with np.errstate(over="ignore"):
            values = np.ascontiguousarray(part, np.float32)
        # A pixel of zeros is background in either reading and must not influence the choice.
        _clear(values, drawn[rows])
        normals[rows] = values
    return drawn, finite, alpha


def _some(normals: Float32 | BandFile, chosen: Bool, bands: list[slice]) -> Float32:
    """Return ``(N, 3)`` values of some of the chosen pixels."""
    every, seen = 1 + int(np.count_nonzero(chosen)) // _MOST_COMPARED, 0
    found = [np.zeros((0, 3), np.float32)]
    for rows in bands:
        places = np.flatnonzero(chosen[rows])
        found.append(normals[rows].reshape(-1, 3)[places[-seen % every :: every]])
        seen += len(places)
    return np.concatenate(found)


def _distance_to_unit(vectors: Float32) -> float:
    with np.errstate(over="ignore"):
        length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return float(np.median(np.abs(length - 1))) if len(vectors) else 0.0


def _were_colours(values: Float32) -> bool:
    """Return whether values that are not negative are codes converted from sRGB to light.

    Vectors of other lengths that all point to one side may seem to have another curve.
    """
    values = values[:: 1 + len(values) // _MOST_DECODED]
    read = values * 2 - 1
    encoding = normal_encoding(read)
    encoding.apply(read)
    kind = None if encoding.curve is None else encoding.curve.kind
    return kind == "table" and 3 * _distance_to_unit(read) < _distance_to_unit(values)


def _share(alpha: AnyArray) -> Float32:
    full = float(np.iinfo(alpha.dtype).max) if np.issubdtype(alpha.dtype, np.integer) else 1.0
    return np.asarray(np.nan_to_num(alpha.astype(np.float32) / np.float32(full)))


def _mask_of_alpha(file: Path, share: Float32) -> tuple[Bool | None, Notice]:
    """Return the mask given by the alpha channel, and a note about it."""
    inside = share > 0.5
    if not inside.any():
        raise DataError(
            f"{file}: the alpha channel is below half everywhere: save the image without alpha, "
            "or put a mask.png into its folder"
        )
    if inside.all():
        text = "the alpha channel is opaque everywhere and is ignored"
        return None, Notice("alpha-opaque", text, str(file), "info")
    text = f"the alpha channel is the mask, {np.count_nonzero(inside)} of {inside.size} pixels"
    return inside, Notice("alpha-is-mask", text, str(file), "info")


def _partly(share: Float32) -> Bool:
    return np.asarray((share > 0) & (share < 1))


def _is_premultiplied(
    normals: Float32 | BandFile, share: Float32, bands: list[slice], *, doubled: bool
) -> bool:
    """Return whether encoded colours are multiplied by alpha.

    Files do not state this reliably. Vectors that are stored without an encoding would only change
    their length.
    """
    partly = _partly(share)
    vectors = _some(normals, partly, bands)
    if doubled:
        vectors = vectors * 2 - 1
    shares = share[partly][:: 1 + int(np.count_nonzero(partly)) // _MOST_COMPARED]
    divided = (vectors + 1) / shares[:, None] - 1
    return _distance_to_unit(divided) < _distance_to_unit(vectors)


def _divide(vectors: Float32, share: Float32) -> None:
    partly = _partly(share)
    vectors[partly] = (vectors[partly] + 1) / share[partly][:, None] - 1


def _eight_bits(file: Path) -> Notice:
    cost = "0.4" if file.suffix.lower() in (".jpg", ".jpeg") else "0.2"
    text = f"8-bit normals are quantised, an error of about {cost} degree"
    return Notice("normals-8-bit", text, str(file))


@numba.njit(nogil=True, cache=True)
def encode(first: int, last: int, normals: Float32, mask: Bool, green: float, out: UInt16) -> None:
    """Write ``round((n / 2 + 0.5) * 65535)``, and z toward the camera outside a mask.

    Parameters
    ----------
    normals, mask
        ``(H, W, 3)`` vectors, 0 outside, and ``(H, W)``.
    green
        1, or -1 to invert the second channel.
    out
        ``(H, W, 3)``.
    """
    for r in range(first, last):
        for c in range(mask.shape[1]):
            x, y = np.float64(normals[r, c, 0]), np.float64(normals[r, c, 1])
            z = np.float64(normals[r, c, 2]) if mask[r, c] else 1.0
            out[r, c, 0] = np.uint16(np.rint((x * 0.5 + 0.5) * 65535))
            out[r, c, 1] = np.uint16(np.rint((y * (green * 0.5) + 0.5) * 65535))
            out[r, c, 2] = np.uint16(np.rint((z * 0.5 + 0.5) * 65535))


@numba.njit(cache=True)
def _clear(vectors: Float32, drawn: Bool) -> None:
    """Set ``(H, W, 3)`` vectors that are not finite or too long to 0, and write which are not 0."""
    for r in range(len(drawn)):
        for c in range(drawn.shape[1]):
            x, y, z = vectors[r, c, 0], vectors[r, c, 1], vectors[r, c, 2]
            # False for NaN.
            usable = abs(x) < _LONGEST and abs(y) < _LONGEST and abs(z) < _LONGEST
            if not usable:
                vectors[r, c, 0] = vectors[r, c, 1] = vectors[r, c, 2] = 0
            drawn[r, c] = usable and (x != 0 or y != 0 or z != 0)


@numba.njit(cache=True)
def _lengths(vectors: Float32, out: Float32) -> None:
    """Write the lengths of ``(H, W, 3)`` vectors."""
    for r in range(len(out)):
        for c in range(out.shape[1]):
            x, y, z = vectors[r, c, 0], vectors[r, c, 1], vectors[r, c, 2]
            out[r, c] = np.sqrt(x * x + y * y + z * z)
