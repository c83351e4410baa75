"""What can go wrong on the bench. Every message says what, where and what to do, in one line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Self


class RigError(RuntimeError):
    """The rig cannot do what was asked (exit code 3 at the front door)."""


class BoardError(RigError):
    """The LED board or its serial line failed; the message names port, command and LED."""


class CameraError(RigError):
    """The camera failed; the message names the node or the frame that was awaited."""


class CameraGoneError(CameraError):
    """The camera does not answer any more."""


class FrameLostError(CameraError):
    """The frame of a trigger is missing, incomplete, or not proven to be of that trigger.

    Neither the object nor the light is at fault, so the shot may simply be taken again.

    Parameters
    ----------
    message
        What happened.
    counts
        What the camera's stream has counted since acquisition was started, as far as its GenTL
        producer counts: frames ``started``, ``delivered``, and ``underrun``, those that found no
        free buffer; and ``buffers``, how many there are.
    """

    def __init__(self, message: str, counts: Mapping[str, int] | None = None) -> None:
        super().__init__(message)
        self.counts = dict(counts or {})

    @property
    def host_is_slow(self) -> bool:
        """Whether frames found no free buffer: this computer did not return them in time."""
        return self.counts.get("underrun", 0) > 0

    def because(self, more: str) -> Self:
        """Return the same error with more to say."""
        return type(self)(f"{self}; {more}", self.counts)


class FrameTimeoutError(FrameLostError):
    """A frame did not come in time, and the camera has nothing to say about it."""


class RigConfigError(RigError, ValueError):
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
