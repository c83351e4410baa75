"""Training pairs on disk: some hundred megabytes, made once, read at random."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import acquisition
import rig
from sgp._superres.pairs import Domain, Float, pair

_PER_FILE = 30
_FULL = 32767  # length of a unit vector as it is stored


@dataclass(frozen=True, eq=False)
class PairFiles:
    """Pairs of low and high resolution, as 16-bit integers.

    Parameters
    ----------
    low, high
        ``(h, w, 3)`` and ``(s h, s w, 3)`` of each surface, mapped from files.
    """

    low: Sequence[npt.NDArray[np.int16]]
    high: Sequence[npt.NDArray[np.int16]]

    def __len__(self) -> int:
        return len(self.low)

    def joined(self, other: PairFiles) -> PairFiles:
        """Return the pairs of both."""
        return PairFiles([*self.low, *other.low], [*self.high, *other.high])

    def crop(self, index: int, top: int, left: int, side: int) -> tuple[Float, Float]:
        """Return a square of low resolution, `side` pixels wide, and the same at high."""
        low, high = self.low[index], self.high[index]
        scale = len(high) // len(low)
        return (
            _vectors(low[top : top + side, left : left + side]),
            _vectors(
                high[
                    scale * top : scale * (top + side),
                    scale * left : scale * (left + side),
                ]
            ),
        )


def make_pairs(
    name: str,
    normals: Callable[[int, int], Float],
    seeds: range,
    folder: Path,
    side: int,
    scale: int,
    domain: Domain,
    on_progress: rig.Progress,
) -> PairFiles:
    """Return the pairs of random surfaces; those whose files exist are not made again.

    Parameters
    ----------
    name
        Stage of the progress; the names of the files begin with it.
    normals
        Makes the normals of a surface from its seed and its side.
    seeds
        Seeds of the surfaces.
    folder
        Folder of the files.
    side
        Side of the surfaces in pixels of high resolution.
    scale, domain
        As for `pair`.
    on_progress
        Receives the stage `name`, one step per surface.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    low: list[npt.NDArray[np.int16]] = []
    high: list[npt.NDArray[np.int16]] = []
    start = name.replace(" ", "-")
    on_progress(name, 0, len(seeds))
    for first in range(0, len(seeds), _PER_FILE):
        chosen = seeds[first : first + _PER_FILE]
        paths = [folder / f"{start}-{kind}-{first:05}.npy" for kind in ("low", "high")]
        if not all(path.is_file() for path in paths):
            pairs = [pair(normals(seed, side), scale, domain) for seed in chosen]
            for path, images in zip(paths, zip(*pairs, strict=True), strict=True):
                _write(path, images)
        low += list(np.load(paths[0], mmap_mode="r"))
        high += list(np.load(paths[1], mmap_mode="r"))
        on_progress(name, first + len(chosen), len(seeds))
    return PairFiles(low, high)


def _write(path: Path, images: Sequence[Float]) -> None:
    content = io.BytesIO()
    np.save(content, np.round(_FULL * np.stack(images)).astype(np.int16))
    acquisition.write_durably(path, content.getvalue())


def _vectors(stored: npt.NDArray[np.int16]) -> Float:
    return stored.astype(np.float32) / np.float32(_FULL)
