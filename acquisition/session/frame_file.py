"""The file of a new frame: a name that no other take has, and TIFF without compression."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from acquisition.files.storage import disk, published, write_whole
from acquisition.pixels.plain_rows import plain_tiff_header
from acquisition.plan.plan import CapturePlan
from acquisition.plan.planned_shot import PlannedShot
from rig.arrays import UInt16
from rig.host import threads

# Size of the pieces, small enough to be hashed while still in the cache.
_PIECE: Final = 1 << 20


class FrameNames:
    """Assigns file names; safe to use from several threads.

    Parameters
    ----------
    folder
        Folder of the frames.
    plan
        Plan of the session; the numbers of its repeats are reserved for them.
    taken
        Names of recorded frames, even if their files no longer exist.
    """

    def __init__(self, folder: Path, plan: CapturePlan | None, taken: Iterable[str] = ()) -> None:
        self._folder = folder
        self._first_retake = 1
        if plan is not None:
            repeats = len(plan.lights_before_repeats)
            self._first_retake = max(plan.repeats, plan.flats, repeats)
        self._taken = set(taken)
        self._lock = threads.Lock()

    @contextmanager
    def reserve(self, shot: PlannedShot) -> Iterator[Path]:
        """Reserve a path for the next take of a shot; after an error in the block it is free."""
        number, retake = shot.repeat, self._first_retake
        with self._lock:
            while True:
                path = self._folder / shot.take_file(number)
                if path.name not in self._taken and not path.exists():
                    break
                number, retake = retake, retake + 1
            self._taken.add(path.name)
        try:
            yield path
        except BaseException:
            # If the file exists by now, without a line, its name is still not used again.
            with self._lock:
                self._taken.discard(path.name)
            raise


@dataclass(frozen=True)
class StoredFrame:
    """Journal entries about the file of a frame.

    Parameters
    ----------
    bytes
        Size of the file.
    file_sha256, pixels_sha256
        Hashes of the file, and of the samples as 16-bit little-endian, row by row from the top,
        channels innermost.
    """

    bytes: int
    file_sha256: str
    pixels_sha256: str


def store_frame(path: Path, pixels: UInt16) -> StoredFrame:
    """Write a frame under a temporary name, flush it, and rename it.

    The samples are written directly from the array without copies, and the GIL is released during
    writing and hashing. Equal pixels give equal bytes.

    Parameters
    ----------
    path
        An unused path.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` uint16; they are copied once if not contiguous.

    Raises
    ------
    StorageError
        If the disk refuses; ``path`` then does not exist or is the complete frame.
    """
    samples = np.ascontiguousarray(pixels, dtype="<u2").data.cast("B")
    header = plain_tiff_header(pixels.shape, len(samples))
    of_file, of_pixels = hashlib.sha256(header), hashlib.sha256()
    with published(path) as part, disk(path, "write"):
        write_whole(part.descriptor, header)
        for start in range(0, len(samples), _PIECE):
            piece = samples[start : start + _PIECE]
            write_whole(part.descriptor, piece)
            of_file.update(piece)
            of_pixels.update(piece)
    return StoredFrame(len(header) + len(samples), of_file.hexdigest(), of_pixels.hexdigest())
