"""The exceptions of GenICam and GenTL as one-line `CameraError`s."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

from genicam import genapi, gentl

from rig._errors import CameraError, CameraGoneError

# Neither family knows the other.
GENICAM_ERRORS: tuple[type[Exception], ...] = (genapi.GenericException, gentl.GenericException)

_GONE: tuple[type[Exception], ...] = (
    gentl.IoException,
    gentl.InvalidHandleException,
    gentl.NotInitializedException,
)
# Places in foreign source code, error numbers, and what the message has said before.
_NOISE = re.compile(
    r"GenTL exception: |\s*\(file '[^']*', line \d+\)|\s*\(ID: -?\d+\)"
    r"|[ :.]*\w+Exception thrown .*"
)


def in_words(error: BaseException) -> str:
    """Return what an exception says, in one line."""
    said = " ".join(_NOISE.sub("", str(error)).split()).strip(" :.")
    return said or type(error).__name__


@contextlib.contextmanager
def told(what: str) -> Iterator[None]:
    """Turn whatever GenICam raises into a `CameraError` that begins with ``what``.

    Raises
    ------
    CameraError
        In place of any exception of GenICam; that one is its cause.
    """
    try:
        yield
    except _GONE as error:
        raise CameraGoneError(
            f"{what}: the camera does not answer any more ({in_words(error)}); check its cable and "
            "power, then open it again"
        ) from error
    except GENICAM_ERRORS as error:
        raise CameraError(f"{what}: {in_words(error)}") from error
