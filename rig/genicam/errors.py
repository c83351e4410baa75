"""Conversion of GenICam and GenTL exceptions to one-line `CameraError`s."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

from genicam import genapi, gentl

from rig._errors import CameraError, CameraGoneError

# The two families have no common base class.
GENICAM_ERRORS: tuple[type[Exception], ...] = (genapi.GenericException, gentl.GenericException)

_GONE: tuple[type[Exception], ...] = (
    gentl.IoException,
    gentl.InvalidHandleException,
    gentl.NotInitializedException,
)
# Locations in the libraries' source code, error numbers, and repetitions of the message.
_NOISE = re.compile(
    r"GenTL exception: |\s*\(file '[^']*', line \d+\)|\s*\(ID: -?\d+\)"
    r"|[ :.]*\w+Exception thrown .*"
)


def in_words(error: BaseException) -> str:
    """Return the message of an exception as one line."""
    said = " ".join(_NOISE.sub("", str(error)).split()).strip(" :.")
    return said or type(error).__name__


@contextlib.contextmanager
def camera_errors(what: str) -> Iterator[None]:
    """Convert any exception of GenICam to a `CameraError` whose message begins with ``what``.

    Raises
    ------
    CameraError
        Instead of the exception of GenICam, which is its cause.
    """
    try:
        yield
    except _GONE as error:
        raise CameraGoneError(
            f"{what}: the camera no longer answers ({in_words(error)}); check its cable and power"
        ) from error
    except GENICAM_ERRORS as error:
        raise CameraError(f"{what}: {in_words(error)}") from error
