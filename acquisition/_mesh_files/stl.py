"""STL files, binary and text."""

from __future__ import annotations

from typing import Final

import numpy as np

from acquisition._mesh_files.mesh_file import MeshFile
from acquisition._mesh_files.numbers import numbers_of
from rig import UnreadableError

_HEAD: Final = 84
_FACET: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])


def read_stl(data: bytes) -> MeshFile:
    """Read an STL file; every facet gets three vertices of its own.

    Raises
    ------
    UnreadableError
        If the file is damaged, or shorter than its header states.
    """
    count = int.from_bytes(data[80:84], "little")
    size = _HEAD + count * _FACET.itemsize
    # Some programs start binary files with the keyword of the text format.
    if data.lstrip()[:5].lower() == b"solid" and len(data) != size:
        return _text(data)
    if len(data) < max(size, _HEAD):
        raise UnreadableError("truncated: shorter than its header says: get the complete file")
    corners = np.frombuffer(data, _FACET, count, _HEAD)["corners"].reshape(-1, 3)
    return MeshFile(corners.astype(np.float64), _each_three(len(corners)))


def _text(data: bytes) -> MeshFile:
    words = data.lower().split()
    places = [place for place, word in enumerate(words) if word == b"vertex"]
    facets = words.count(b"endfacet")
    if not facets or len(places) != 3 * facets or b"endsolid" not in words[-200:]:
        raise UnreadableError(
            f"truncated or damaged: {len(places)} vertices for {facets} complete facets: get the "
            "complete file"
        )
    numbers = numbers_of(b" ".join(b" ".join(words[at + 1 : at + 4]) for at in places))
    if len(numbers) != 3 * len(places):
        raise UnreadableError("a vertex that is not three numbers")
    return MeshFile(numbers.reshape(-1, 3), _each_three(len(places)))


def _each_three(count: int) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    return np.arange(count, dtype=np.int64).reshape(-1, 3)
