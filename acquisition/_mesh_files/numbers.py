"""Fast, strict parser for texts of numbers."""

from __future__ import annotations

import warnings

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


def _first(text: bytes) -> str:
    """Return the first word that is not a number."""
    for word in text.split():
        try:
            float(word)
        except ValueError:
            return word[:30].decode("ascii", "backslashreplace")
    return ""
