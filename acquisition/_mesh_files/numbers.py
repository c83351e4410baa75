"""Fast, strict parser for texts of numbers."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from rig import UnreadableError


def numbers_of(text: bytes) -> npt.NDArray[np.float64]:
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


def whole(values: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
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
