"""The number of buffers of a camera's stream, and of copies if there are too few buffers."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, Final, Self

from genicam.gentl import BufferToken

from rig.genicam.errors import GENICAM_ERRORS

_REFUSALS: tuple[type[Exception], ...] = (*GENICAM_ERRORS, MemoryError)
LEAST: Final = 4
# Extra buffers for unexpected frames, for instance from noise on the trigger line.
_SPARE: Final = 2
_MOST_BYTES: Final = 2**30
_SHARE_OF_MEMORY: Final = 0.25


@dataclass(frozen=True)
class Buffering:
    """Room for pending frames.

    Parameters
    ----------
    buffers
        Number of buffers to announce to the GenTL producer.
    copies
        Number of additional frames that may be kept as copies; 0 if the buffers suffice.
    """

    buffers: int
    copies: int = 0

    @classmethod
    def within(cls, limit: int, frames: int, payload: int) -> Self:
        """Return the room for frames: one buffer each, or as much as fits into the allowed memory.

        Buffers need no work while frames arrive, so each frame gets one. If memory does not allow
        that, half of it is for copies, which also compensate for a producer that accepts fewer
        buffers.

        Parameters
        ----------
        limit
            Limit for all frames in bytes; a minimum number of frames is kept even if they exceed
            it.
        frames
            Number of frames that may be pending at once.
        payload
            Size of one frame in bytes.
        """
        fit = limit // max(1, payload)
        if frames + _SPARE <= max(fit, LEAST):
            return cls(max(LEAST, frames + _SPARE))
        return cls.with_copies(max(LEAST, fit // 2), frames, fit)

    @classmethod
    def with_copies(cls, buffers: int, frames: int, fit: int) -> Self:
        """Return the room with this number of buffers, if ``fit`` frames fit into memory."""
        if buffers >= frames:
            return cls(buffers)
        return cls(buffers, min(frames, max(LEAST, fit - buffers)))


def memory_limit() -> int:
    """Return the default limit for frames in bytes: 1 GiB, or a quarter of memory if less."""
    try:
        installed = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows
        return _MOST_BYTES
    return min(_MOST_BYTES, int(_SHARE_OF_MEMORY * installed))


def announceable(stream: Any, payload: int, wanted: int) -> int:
    """Return how many of the wanted buffers a producer accepts, by announcing them.

    Parameters
    ----------
    stream
        genicam's ``DataStream``, not acquiring and without buffers.
    payload
        Size of each buffer in bytes.
    wanted
        Number of buffers.
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
