"""Planes: maps as few exact bytes, which the page decodes (decision 60)."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np

from rig.arrays import Float32, UInt8, UInt16

Samples = UInt8 | UInt16
Kind = Literal["vectors", "scalar", "colour", "flags"]
Colours = Literal["height", "doubt", "signed", "plain"]

# Steps of each coordinate of a direction. Even, so that (0, 0, 1) is exact.
VECTOR_STEPS: Final = 4094
_DEFLATE: Final = 6
_BAND: Final = 48  # rows; one band of four is encoded to estimate the size


@dataclass(frozen=True, eq=False)
class Plane:
    """One map of a page.

    Parameters
    ----------
    name
        Name within the result, such as ``normals``.
    kind
        ``vectors``: two octahedral coordinates. ``scalar``: one channel. ``colour``: sRGB samples.
        ``flags``: bits.
    samples
        ``(H, W, C)``; 0 means no value, except in colours.
    low, step
        A scalar is ``low + step * (sample - 1)``.
    label, unit
        For people.
    colours
        The colour map of a scalar.
    shown
        Values at the ends of its colour scale.
    """

    name: str
    kind: Kind
    samples: Samples
    low: float = 0.0
    step: float = 0.0
    label: str = ""
    unit: str = ""
    colours: Colours = "plain"
    shown: tuple[float, float] = (0.0, 1.0)

    def header(self) -> dict[str, Any]:
        """Return what the page has to know to decode and show the plane."""
        rows, columns, channels = self.samples.shape
        return {
            "name": self.name,
            "kind": self.kind,
            "rows": rows,
            "columns": columns,
            "channels": channels,
            "bits": 8 * self.samples.itemsize,
            "low": self.low,
            "step": self.step,
            "label": self.label,
            "unit": self.unit,
            "colours": self.colours,
            "shown": list(self.shown),
        }

    @cached_property
    def encoded(self) -> str:
        """The samples as base64 of deflated differences."""
        return base64.b64encode(zlib.compress(_differences(self.samples), _DEFLATE)).decode()

    @cached_property
    def estimated(self) -> float:
        """About how long the encoded samples are, from a part of them."""
        bands = [
            self.samples[top : top + _BAND] for top in range(_BAND, len(self.samples), 4 * _BAND)
        ]
        rows = sum(len(band) for band in bands)
        if 2 * rows < _BAND:
            return len(self.encoded)
        size = sum(len(zlib.compress(_differences(band), _DEFLATE)) for band in bands)
        return 4 / 3 * size * len(self.samples) / rows


def vectors_plane(name: str, vectors: Float32, label: str) -> Plane:
    """Return a plane of ``(H, W, 3)`` unit vectors; those of length 0 have no value."""
    length = np.abs(vectors).sum(axis=2)
    known = length > 0
    share = np.divide(
        vectors[..., :2],
        length[..., None],
        out=np.zeros_like(vectors[..., :2]),
        where=known[..., None],
    )
    # The lower half of the octahedron is folded outwards.
    folded = (1 - np.abs(share[..., ::-1])) * np.where(share < 0, -1, 1)
    share = np.where(vectors[..., 2:] < 0, folded, share)
    samples = np.rint((share + 1) * (VECTOR_STEPS / 2)).astype(np.uint16) + np.uint16(1)
    samples[~known] = 0
    return Plane(name, "vectors", samples, label=label)


def scalar_plane(
    name: str,
    values: Float32,
    label: str,
    unit: str,
    colours: Colours,
    *,
    bits: Literal[8, 16] = 8,
    shown: tuple[float, float] | None = None,
    limits: tuple[float, float] | None = None,
) -> Plane:
    """Return a plane of ``(H, W)`` numbers; NaN has no value.

    ``limits`` are the values of the smallest and the largest sample, by default the extremes;
    values beyond them are limited. ``shown`` defaults to the limits.
    """
    known = np.isfinite(values)
    if limits is None:
        limits = (float(values[known].min()), float(values[known].max())) if known.any() else (0, 0)
    low, high = limits
    steps = (1 << bits) - 2
    step = (high - low) / steps or 1.0
    scaled = np.rint((np.where(known, values, low).astype(np.float64) - low) / step)
    samples = np.where(known, np.clip(scaled, 0, steps) + 1, 0)[..., None]
    stored: Samples = samples.astype(np.uint8) if bits == 8 else samples.astype(np.uint16)
    return Plane(name, "scalar", stored, low, step, label, unit, colours, shown or limits)


def colour_plane(name: str, picture: UInt8, label: str) -> Plane:
    """Return a plane of sRGB samples, ``(H, W)`` or ``(H, W, 3)``."""
    samples = picture[..., None] if picture.ndim == 2 else picture
    return Plane(name, "colour", np.ascontiguousarray(samples), label=label)


def _differences(samples: Samples) -> bytes:
    """Return the prediction errors of each channel: low bytes, then high bytes if there are any."""
    bits = 8 * samples.itemsize
    half, top = 1 << (bits - 1), (1 << bits) - 1
    parts: list[bytes] = []
    for channel in range(samples.shape[2]):
        padded = np.pad(samples[..., channel].astype(np.int32), ((1, 0), (1, 0)))
        here, left, up, corner = padded[1:, 1:], padded[1:, :-1], padded[:-1, 1:], padded[:-1, :-1]
        slope = left + up - corner
        predicted = np.maximum(np.minimum(left, up), np.minimum(np.maximum(left, up), slope))
        error = ((here - predicted + half) & top) - half
        folded = ((error << 1) ^ (error >> 31)).astype(np.uint16)
        parts.append((folded & 255).astype(np.uint8).tobytes())
        if bits > 8:
            parts.append((folded >> 8).astype(np.uint8).tobytes())
    return b"".join(parts)


SIDE: Final = 512  # pixels, without the border
_BORDER: Final = 1  # pixels of the neighbours on each side, for interpolation and curvature


@dataclass(frozen=True, eq=False)
class Tile:
    """A part of a map at full resolution.

    Parameters
    ----------
    name
        Name of the map.
    row, column
        Place of the tile, counted in tiles.
    header
        What the page has to know to decode it.
    encoded
        Its samples as text.
    """

    name: str
    row: int
    column: int
    header: dict[str, Any]
    encoded: str

    @property
    def key(self) -> str:
        """The name of the tile within the page's result."""
        return f"{self.name}-{self.row}-{self.column}"


def tiles_of(name: str, whole: Float32, make: Callable[[Float32], Plane]) -> list[Tile]:
    """Return the tiles of a map; each is encoded at once and only its text is kept."""
    rows, columns = whole.shape[:2]
    found = []
    for row in range(0, rows, SIDE):
        for column in range(0, columns, SIDE):
            down, across = (
                slice(max(0, at - _BORDER), at + SIDE + _BORDER) for at in (row, column)
            )
            plane = make(whole[down, across])
            numbers = ("rows", "columns", "channels", "bits", "kind", "low", "step")
            header = {key: value for key, value in plane.header().items() if key in numbers}
            found.append(Tile(name, row // SIDE, column // SIDE, header, plane.encoded))
    return found
