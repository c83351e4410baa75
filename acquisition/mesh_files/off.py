"""OFF files: vertices and polygons as text.

Format: Geomview manual, OFF.
"""

from __future__ import annotations

import re

import numpy as np

from acquisition.mesh_files.mesh_file import MeshFile, numbers_of, whole
from acquisition.mesh_files.polygons import triangles_of
from rig import UnreadableError

# Texture, colour and normal follow the coordinates; other spaces have no surface in 3D.
_KEYWORD = re.compile(rb"(ST)?C?N?OFF", re.IGNORECASE)


def read_off(data: bytes) -> MeshFile:
    """Read an OFF file; texture, colours and normals are left out.

    Raises
    ------
    UnreadableError
        If the file is damaged, or has fewer or more lines than its header states.
    """
    lines = [words for line in data.splitlines() if (words := line.partition(b"#")[0].split())]
    keyword = lines[0].pop(0) if lines and b"OFF" in lines[0][0].upper() else b"OFF"
    lines = [words for words in lines if words]
    counts = lines.pop(0) if lines else []
    if not _KEYWORD.fullmatch(keyword):
        raise UnreadableError(f"{keyword[:20]!r} files are not supported: save it as OFF")
    if len(counts) not in (2, 3) or not all(re.fullmatch(rb"[0-9]{1,10}", n) for n in counts):
        raise UnreadableError("its header has no counts of vertices and faces")
    vertices, faces = map(int, counts[:2])
    if len(lines) != vertices + faces:
        raise UnreadableError(
            f"{'truncated: ' if len(lines) < vertices + faces else ''}its header states "
            f"{vertices + faces} lines of vertices and faces, it has {len(lines)}: get the "
            "complete file"
        )
    short = next((words for words in lines[:vertices] if len(words) < 3), None)
    if short is not None:
        raise UnreadableError(f"a vertex of {len(short)} numbers: the file is damaged")
    points = numbers_of(b" ".join(word for words in lines[:vertices] for word in words[:3]))
    lengths = whole(numbers_of(b" ".join(words[0] for words in lines[vertices:])))
    sizes = np.array([len(words) for words in lines[vertices:]], np.int64)
    if ((lengths < 0) | (lengths >= sizes)).any():
        raise UnreadableError("a face with fewer vertices than it states: the file is damaged")
    polygons = zip(lines[vertices:], lengths, strict=True)
    corners = numbers_of(b" ".join(word for words, n in polygons for word in words[1 : n + 1]))
    table = points.reshape(-1, 3)
    split, notices = triangles_of(lengths, whole(corners), table)
    return MeshFile(table, split if faces else None, None, notices)
