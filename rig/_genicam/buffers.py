"""How many buffers a camera's stream gets, and what becomes of frames when there are too few."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, Final

from genicam.gentl import BufferToken

from rig._genicam.errors import GENICAM_ERRORS

_REFUSALS: tuple[type[Exception], ...] = (*GENICAM_ERRORS, MemoryError)
LEAST: Final = 4
# Of the frames that nobody awaits, such as that of a noise pulse, so many take none of another.
_SPARE: Final = 2
_MOST_BYTES: Final = 2**30
_SHARE_OF_MEMORY: Final = 0.25


@dataclass(frozen=True)
class Buffering:
    """Room for the frames that are under way.

    Parameters
    ----------
    buffers
        To be announced to the GenTL producer.
    copies
        Frames that may be kept beside them, copied out of their buffers; 0 where the buffers are
        enough.
    """

    buffers: int
    copies: int = 0


def memory_limit() -> int:
    """Return the bytes that frames may take where nobody says so: 1 GiB or a quarter of memory."""
    try:
        installed = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows
        return _MOST_BYTES
    return min(_MOST_BYTES, int(_SHARE_OF_MEMORY * installed))


def buffering(frames: int, payload: int, limit: int) -> Buffering:
    """Return the room that frames get: a buffer each, or what fits into the memory allowed.

    Buffers need no work while frames come in, so each frame gets one. Where memory does not allow
    that, half of it is for copies: they stand in when the producer takes fewer buffers still.

    Parameters
    ----------
    frames
        How many may be under way at once.
    payload
        Bytes of one.
    limit
        Bytes that all may take; some frames are kept even where they take more.
    """
    fit = limit // max(1, payload)
    if frames + _SPARE <= max(fit, LEAST):
        return Buffering(max(LEAST, frames + _SPARE))
    return with_copies(max(LEAST, fit // 2), frames, fit)


def with_copies(buffers: int, frames: int, fit: int) -> Buffering:
    """Return the room with this number of buffers, where so many frames fit into memory."""
    if buffers >= frames:
        return Buffering(buffers)
    return Buffering(buffers, min(frames, max(LEAST, fit - buffers)))


def announceable(stream: Any, payload: int, wanted: int) -> int:
    """Return how many buffers a producer takes, at most those wanted, by trying it.

    Parameters
    ----------
    stream
        genicam's ``DataStream``, not acquiring and without buffers.
    payload
        Bytes of each.
    wanted
        How many.
    """
    announced: list[Any] = []
    try:
        while len(announced) < wanted:
            token = BufferToken(bytes(payload), len(announced))
            announced.append(stream.announce_buffer(token))
    except _REFUSALS:
        pass
    finally:
        for buffer in announced:
            stream.revoke_buffer(buffer)
    return len(announced)
