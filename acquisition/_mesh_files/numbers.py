"""Texts of numbers, read at the speed of C and refused where they hold anything else."""

from __future__ import annotations

import warnings

import numpy as np
import numpy.typing as npt

from rig import UnreadableError


def numbers_of(text: bytes) -> npt.NDArray[np.float64]:
    """Return the numbers of a text, which white space separates.

    Raises
    ------
    UnreadableError
        If it holds anything else.
    """
    if not text.strip():
        return np.zeros(0)
    if b"\0" in text:
        raise UnreadableError("not a text of numbers")
    try:
        with warnings.catch_warnings():
            # What ends the numbers is told by a warning.
            warnings.simplefilter("error", DeprecationWarning)
            return np.fromstring(text, np.float64, sep=" ")
    except (DeprecationWarning, ValueError) as error:
        raise UnreadableError(f"holds something else than numbers ({_first(text)!r})") from error


def _first(text: bytes) -> str:
    """Return the first word that is no number."""
    for word in text.split():
        try:
            float(word)
        except ValueError:
            return word[:30].decode("ascii", "backslashreplace")
    return ""
