"""Errors of the bench. Every message states in one line what is wrong, where, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import ClassVar, Final, Literal, Self

from rig.files.guard import SgpError

# How notes begin that report LEDs that may be on.
UNCONFIRMED: Final = "LEDs not confirmed off"


class RigError(SgpError, RuntimeError):
    """The rig cannot do what was requested (exit code 3 of the command line)."""


class BoardError(RigError):
    """The LED board or its serial line failed; the message names port, command and LED."""


class CameraError(RigError):
    """The camera failed; the message names the node or the expected frame."""


class DeviceGoneError(RigError):
    """The board or the camera no longer answers; `rig.Rig.recover` waits for it.

    Attributes
    ----------
    device
        Which of them.
    """

    device: ClassVar[Literal["board", "camera"]]


class BoardGoneError(DeviceGoneError, BoardError):
    """The LED board no longer answers."""

    device = "board"


class CameraGoneError(DeviceGoneError, CameraError):
    """The camera no longer answers."""

    device = "camera"


class FrameLostError(CameraError):
    """The frame of a trigger is missing, incomplete, or not proven to be of that trigger.

    The cause is neither the object nor the light, so the shot may simply be taken again.

    Parameters
    ----------
    message
        What happened.
    counts
        Counters of the camera's stream since acquisition was started, as far as its GenTL producer
        has them: frames ``started``, ``delivered``, and ``underrun`` (those that found no free
        buffer); and ``buffers``, the number of buffers.
    """

    def __init__(self, message: str, counts: Mapping[str, int] | None = None) -> None:
        super().__init__(message)
        self.counts = dict(counts or {})

    @property
    def host_is_slow(self) -> bool:
        """Whether frames found no free buffer because this computer did not return any in time."""
        return self.counts.get("underrun", 0) > 0

    def with_context(self, context: str) -> Self:
        """Return the same error with an addition to its message, after a semicolon."""
        return type(self)(f"{self}; {context}", self.counts)


class FrameTimeoutError(FrameLostError):
    """A frame did not arrive in time, and the camera reports no reason."""


class RigConfigError(RigError, ValueError):
    """A rig file or rig name is invalid."""


class RigNotFoundError(RigConfigError):
    """There is no rig of this name, or no such rig file (exit code 2 of the command line)."""


def note(error: BaseException, what: str, failure: Exception) -> None:
    """Add a later failure and its notes to the error that was raised first.

    If both report that the same device no longer answers, nothing is added.
    """
    if isinstance(failure, DeviceGoneError) and getattr(error, "device", "") == failure.device:
        return
    for said in (str(failure), *getattr(failure, "__notes__", ())):
        error.add_note(f"{what}: {said}")


def note_unconfirmed(error: BaseException, failure: Exception) -> None:
    """Note once that LEDs may be on, with the reason if that is not the error itself."""
    before = list(getattr(error, "__notes__", ()))
    if any(line.startswith(UNCONFIRMED) for line in before):
        return
    note(error, UNCONFIRMED, failure)
    if getattr(error, "__notes__", []) == before:
        error.add_note(UNCONFIRMED)


def close_after(error: BaseException, close: Callable[[], object]) -> None:
    """Close something while an error is handled; a failure is added to that error as a note."""
    try:
        close()
    except Exception as failure:  # noqa: BLE001
        note(error, "on closing", failure)


@contextmanager
def closed_after_errors(close: Callable[[], object]) -> Iterator[None]:
    """Close something if the block raises an error; a failure is added to that error as a note."""
    try:
        yield
    except BaseException as error:
        close_after(error, close)
        raise
