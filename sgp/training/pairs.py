"""Pairs of low and high resolution that a network learns from."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

import acquisition
import processing
import rig
from rig.arrays import Float32, Floating, Int16

Domain = Literal["detail", "normals"]


def averaged(normals: Float32, scale: int) -> Float32:
    """Return normals as a sensor of lower resolution measures them.

    Parameters
    ----------
    normals
        ``(s h, s w, 3)`` unit vectors.
    scale
        Width of the squares that are averaged.

    Returns
    -------
    Float
        ``(h, w, 3)`` unit vectors.
    """
    height, width = normals.shape[0] // scale, normals.shape[1] // scale
    squares = normals.reshape(height, scale, width, scale, 3)
    return _unit(squares.mean(axis=(1, 3), dtype=np.float64))


def pair(normals: Float32, scale: int, domain: Domain) -> tuple[Float32, Float32]:
    """Return the input of a network and the result that it should have.

    In the domain ``detail``, the input is the detail component of the low resolution, and the
    target the detail of the normals relative to the enlarged shape, R(S_up -> z) N. Combined with
    the enlarged shape, the target is therefore exactly the normals.

    Parameters
    ----------
    normals
        ``(s h, s w, 3)`` unit vectors at high resolution.
    scale
        Factor between the resolutions, 2 or 4.
    domain
        ``detail``, or ``normals`` for the normals themselves.

    Returns
    -------
    low, high
        ``(h, w, 3)`` and ``(s h, s w, 3)`` unit vectors.
    """
    low = averaged(normals, scale)
    if domain == "normals":
        return low, normals
    parts = processing.separate(processing.NormalMap.from_vectors(low))
    size = normals.shape[1::-1]
    shape = cv2.resize(parts.shape.normals, size, interpolation=cv2.INTER_CUBIC)
    high = processing.detail.relative_detail(
        processing.NormalMap.from_vectors(normals), processing.NormalMap.from_vectors(shape)
    )
    return parts.detail.normals, high.normals


def _unit(vectors: Floating) -> Float32:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), np.float32)


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

    low: Sequence[Int16]
    high: Sequence[Int16]

    def __len__(self) -> int:
        return len(self.low)

    def joined(self, other: PairFiles) -> PairFiles:
        """Return the pairs of both."""
        return PairFiles([*self.low, *other.low], [*self.high, *other.high])

    def crop(self, index: int, top: int, left: int, side: int) -> tuple[Float32, Float32]:
        """Return a square of low resolution, `side` pixels wide, and the same at high."""
        low, high = self.low[index], self.high[index]
        scale = len(high) // len(low)
        return (
            _vectors(low[top : top + side, left : left + side]),
            _vectors(
                high[scale * top : scale * (top + side), scale * left : scale * (left + side)]
            ),
        )


def make_pairs(
    name: str,
    normals: Callable[[int, int], Float32],
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
    low: list[Int16] = []
    high: list[Int16] = []
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


def _write(path: Path, images: Sequence[Float32]) -> None:
    content = io.BytesIO()
    np.save(content, np.round(_FULL * np.stack(images)).astype(np.int16))
    acquisition.write_durably(path, content.getvalue())


def _vectors(stored: Int16) -> Float32:
    return stored.astype(np.float32) / np.float32(_FULL)


SYMMETRIES = 8


def turned(normals: Float32, symmetry: int) -> Float32:
    """Return a map turned or mirrored, its vectors too.

    Parameters
    ----------
    normals
        ``(h, w, 3)`` normals or details in the house frame: X right, Y up.
    symmetry
        0 to 7: mirrored horizontally (1), vertically (2), at the diagonal (4), or several of them.
    """
    if symmetry & 1:
        normals = normals[:, ::-1] * _vector(-1, 1, 1)
    if symmetry & 2:
        normals = normals[::-1] * _vector(1, -1, 1)
    if symmetry & 4:
        # Rows grow downwards, Y upwards.
        normals = normals.transpose(1, 0, 2)[..., [1, 0, 2]] * _vector(-1, -1, 1)
    return normals


def batch(pairs: PairFiles, count: int, side: int, key: tuple[int, int]) -> tuple[Float32, Float32]:
    """Return the crops of one step; they depend on the key alone, not on earlier steps.

    Parameters
    ----------
    pairs
        The pairs to choose from.
    count
        Number of crops.
    side
        Side of the crops in pixels of low resolution.
    key
        Seed of the training, and number of the step.

    Returns
    -------
    low, high
        ``(count, side, side, 3)`` and ``(count, s side, s side, 3)`` float32.
    """
    random = np.random.default_rng(key)
    crops = []
    for _ in range(count):
        index, symmetry = int(random.integers(len(pairs))), int(random.integers(SYMMETRIES))
        top, left = random.integers(0, len(pairs.low[index]) - side + 1, 2)
        crops.append([turned(one, symmetry) for one in pairs.crop(index, top, left, side)])
    low, high = zip(*crops, strict=True)
    return np.stack(low), np.stack(high)


def _vector(*values: float) -> Float32:
    return np.array(values, np.float32)
