"""What can go wrong on the bench. Every message says what, where and what to do, in one line."""

from __future__ import annotations

from collections.abc import Callable


class RigError(Exception):
    """The rig cannot do what was asked (exit code 3 at the front door)."""


class BoardError(RigError):
    """The LED board or its serial line failed; the message names port, command and LED."""


class CameraError(RigError):
    """The camera failed; the message names the node or the frame that was awaited."""


class CameraGoneError(CameraError):
    """The camera does not answer any more."""


class FrameTimeoutError(CameraError):
    """A frame did not come in time, and the camera has nothing to say about it."""


class RigConfigError(RigError):
    """A rig file or rig name is not understood."""


class RigNotFoundError(RigConfigError):
    """There is no rig of this name, or no such rig file (exit code 2 at the front door)."""


def note(error: BaseException, what: str, failure: Exception) -> None:
    """Tell of a failure, and of what it notes itself, beside the error that came first.

    That a camera which is gone cannot be closed either is nothing new.
    """
    if isinstance(error, CameraGoneError) and isinstance(failure, CameraGoneError):
        return
    for said in (str(failure), *getattr(failure, "__notes__", ())):
        error.add_note(f"{what}: {said}")


def close_after(error: BaseException, close: Callable[[], object]) -> None:
    """Close something on the way out of an error, which stays the one that is told."""
    try:
        close()
    except Exception as failure:  # noqa: BLE001
        note(error, "on closing", failure)
