"""STL files, binary and text, with one solid or several."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from acquisition.mesh_files.mesh_file import SHORTER, MeshFile, numbers_of
from rig import Notice, UnreadableError
from rig.arrays import Float32, Float64

_HEAD: Final = 84
_FACET: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
# The name of a solid may contain keywords of the format.
_NAMES: Final = re.compile(rb"^\s*(?:end)?solid\b(?!.*\bfacet\b).*$", re.MULTILINE)
_FILL: Final = b"\0\r\n\t "


def read_stl(data: bytes) -> MeshFile:
    """Read an STL file; every facet gets three vertices of its own.

    Raises
    ------
    UnreadableError
        If the file is damaged, shorter than its header states, or longer but by no other solid.
    """
    # Some programs start binary files with the keyword of the text format.
    if data.lstrip()[:5].lower() == b"solid" and not _is_binary(data):
        return _text(data)
    if len(data) < _HEAD:
        raise UnreadableError(SHORTER)
    solids: list[Float32] = []
    rest = memoryview(data)
    while not solids or bytes(rest).strip(_FILL):
        count = int.from_bytes(rest[80:84], "little")
        size = _HEAD + count * _FACET.itemsize
        if len(rest) < max(size, _HEAD):
            if not solids:
                raise UnreadableError(SHORTER)
            stated = sum(len(solid) for solid in solids)
            raise UnreadableError(
                f"it has {len(rest)} bytes ({len(rest) / _FACET.itemsize:.4g} triangles) beyond "
                f"the {stated} triangles that its header states: correct the header, or save the "
                "mesh again"
            )
        solids.append(np.frombuffer(rest, _FACET, count, _HEAD)["corners"].reshape(-1, 3, 3))
        rest = rest[size:]
    return _mesh(np.concatenate(solids).astype(np.float64), len(solids))


def _is_binary(data: bytes) -> bool:
    size = _HEAD + int.from_bytes(data[80:84], "little") * _FACET.itemsize
    return len(data) == size or b"\0" in data[:_HEAD]


def _text(data: bytes) -> MeshFile:
    text = data.lower()
    solids = len(re.findall(rb"^\s*solid\b", text, re.MULTILINE))
    ends = len(re.findall(rb"\bendsolid\b", text))
    words = _NAMES.sub(b"", text).split()
    places = [place for place, word in enumerate(words) if word == b"vertex"]
    facets = words.count(b"endfacet")
    if not facets or len(places) != 3 * facets or ends < solids:
        raise UnreadableError(
            f"truncated or damaged: {len(places)} vertices for {facets} complete facets, "
            f"{ends} of {solids} solids complete: get the complete file"
        )
    numbers = numbers_of(b" ".join(b" ".join(words[at + 1 : at + 4]) for at in places))
    if len(numbers) != 3 * len(places):
        raise UnreadableError("a vertex that is not three numbers")
    return _mesh(numbers, solids)


def _mesh(corners: Float64, solids: int) -> MeshFile:
    text = f"the file contains {solids} solids; all of them are read"
    notices = (Notice("solids-joined", text),) if solids > 1 else ()
    vertices = corners.reshape(-1, 3)
    return MeshFile(vertices, np.arange(len(vertices)).reshape(-1, 3), None, notices)
