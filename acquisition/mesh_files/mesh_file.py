"""Content of a mesh file, and a fast, strict parser for the numbers of its text."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Final

import numpy as np

from rig import Notice, UnreadableError, short_repr
from rig.arrays import AnyArray, Float64, Int64

SHORTER: Final = "truncated: shorter than its header says: get the complete file"


@dataclass(frozen=True, eq=False)
class MeshFile:
    """A triangle mesh or a point cloud, unchanged from its file.

    Parameters
    ----------
    vertices
        ``(V, 3)`` float64; points that a scanner missed may be NaN.
    faces
        ``(F, 3)`` int64 vertex indices; polygons are split into triangles. They are not checked
        against the number of vertices. None if the file has no surface.
    normals
        ``(V, 3)`` normals of the vertices as they are in the file, NaN for vertices without
        one; None if the file has no normals. A vertex with several normals is there several times.
    warnings
        One notice for each kind of data that was left out, or read in a way that others may not
        expect.
    """

    vertices: Float64
    faces: Int64 | None = None
    normals: Float64 | None = None
    warnings: tuple[Notice, ...] = ()

    __repr__ = short_repr


def numbers_of(text: bytes) -> Float64:
    """Return the whitespace-separated numbers of a text.

    Raises
    ------
    UnreadableError
        If the text holds anything other than numbers.
    """
    if not text.strip():
        return np.zeros(0)
    if b"\0" in text:
        raise UnreadableError("not a text of numbers: it contains a zero byte")
    try:
        with warnings.catch_warnings():
            # NumPy reports text that is not a number with a warning.
            warnings.simplefilter("error", DeprecationWarning)
            return np.fromstring(text, np.float64, sep=" ")
    except (DeprecationWarning, ValueError) as error:
        raise UnreadableError(f"text that is not a number ({_first(text)!r})") from error


def whole(values: AnyArray) -> Int64:
    """Return values as integers; raise an UnreadableError if they are not integers."""
    if values.dtype.kind in "iu":
        return np.asarray(values, np.int64)
    # Above 2**53 a double cannot represent every integer.
    if not (np.abs(values) < 2.0**53).all() or (values != np.rint(values)).any():
        raise UnreadableError("a list of vertices with a number that is not an integer")
    return np.asarray(values, np.int64)


def _first(text: bytes) -> str:
    """Return the first word that is not a number."""
    for word in text.split():
        try:
            float(word)
        except ValueError:
            return word[:30].decode("ascii", "backslashreplace")
    return ""
