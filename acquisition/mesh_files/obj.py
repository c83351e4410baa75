"""OBJ files: polygons with positive or negative indices, and normals of corners.

Format: Wavefront, Advanced Visualizer manual, appendix B1 (1995).
"""

from __future__ import annotations

import numpy as np

from acquisition.mesh_files.mesh_file import MeshFile, numbers_of, whole
from acquisition.mesh_files.polygons import triangles_of
from rig import UnreadableError
from rig.arrays import Float64, Int64

# x y z, with a weight, a colour, or both, as several programs write.
_VERTEX_WIDTHS = (3, 4, 6, 7)


def read_obj(data: bytes) -> MeshFile:
    """Read the polygons of an OBJ file; vertices with several normals are repeated.

    Raises
    ------
    UnreadableError
        If a line is damaged, a face refers to a vertex or normal that does not exist, or the file
        has free-form surfaces. The message names the line.
    """
    text = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    points: list[bytes] = []
    normals: list[bytes] = []
    polygons: list[bytes] = []
    # For each polygon: its line, and how many vertices and normals are above it.
    above: tuple[list[int], list[int], list[int]] = ([], [], [])
    for number, line in enumerate(text.splitlines(), 1):
        key, *rest = line.partition(b"#")[0].split(None, 1)[:2] or (b"",)
        if not rest:
            continue
        if key == b"v":
            points += rest
        elif key in (b"f", b"fo"):
            polygons += rest
            above[0].append(number)
            above[1].append(len(points))
            above[2].append(len(normals))
        elif key == b"vn":
            normals += rest
        elif key == b"surf":
            raise UnreadableError(
                f"line {number}: free-form surfaces are not supported: save it with triangles"
            )
    vertices = _table("v", points, _VERTEX_WIDTHS)
    if not polygons:
        return MeshFile(vertices)
    lengths = np.array(list(map(len, map(bytes.split, polygons))), np.int64)
    at, *counts = (np.repeat(np.array(each, np.int64), lengths) for each in above)
    fields = _fields(b" ".join(polygons))
    corners = _places(fields[:, 0], counts[0], len(vertices), at, "vertex")
    if not (normals and fields[:, 2].any()):
        faces, notices = triangles_of(lengths, corners, vertices)
        return MeshFile(vertices, faces, None, notices)
    directions = np.concatenate([_table("vn", normals, (3,)), np.full((1, 3), np.nan)])
    # 0 stands for no normal, which is the last one.
    absent = fields[:, 2] == 0
    known = _places(np.where(absent, 1, fields[:, 2]), counts[1], len(normals), at, "normal")
    which = np.where(absent, len(normals), known)
    pairs, corners = np.unique(corners * len(directions) + which, return_inverse=True)
    vertices, directions = vertices[pairs // len(directions)], directions[pairs % len(directions)]
    faces, notices = triangles_of(lengths, corners.reshape(-1), vertices)
    return MeshFile(vertices, faces, directions, notices)


def _table(key: str, texts: list[bytes], widths: tuple[int, ...]) -> Float64:
    """Return the first three numbers of each line."""
    counts = set(map(len, map(bytes.split, texts)))
    if not counts <= set(widths):
        wrong = next(text for text in texts if len(text.split()) not in widths)
        raise UnreadableError(
            f"the line '{key} {wrong[:40].decode('ascii', 'backslashreplace')}' has "
            f"{len(wrong.split())} numbers instead of x y z"
        )
    if len(counts) > 1:
        texts = [b" ".join(text.split()[:3]) for text in texts]
    numbers = numbers_of(b"\n".join(texts))
    return numbers.reshape(len(texts), -1)[:, :3] if texts else np.zeros((0, 3))


def _fields(text: bytes) -> Int64:
    """Return the ``(C, 3)`` numbers of vertex, texture and normal; 0 for those that are absent."""
    if b"/" not in text:
        fields = whole(numbers_of(text)).reshape(-1, 1)
    else:
        corners = text.split()
        slashes = {corner.count(b"/") for corner in corners}
        if max(slashes) > 2:
            raise UnreadableError("a corner of more than three numbers: the file is damaged")
        numbers = np.zeros(0)
        if len(slashes) == 1:
            numbers = numbers_of(text.replace(b"//", b"/0/").replace(b"/", b" "))
        if len(numbers) != len(corners) * (max(slashes) + 1):
            # Corners of different forms, such as 1/2/3 and 1//3.
            parts = ((*corner.split(b"/"), b"", b"")[:3] for corner in corners)
            numbers = numbers_of(b" ".join(part or b"0" for three in parts for part in three))
        fields = whole(numbers).reshape(len(corners), -1)
    return np.pad(fields, ((0, 0), (0, 3 - fields.shape[1])))


def _places(index: Int64, above: Int64, count: int, number: Int64, what: str) -> Int64:
    """Return places from 0; a negative index counts back from the line of its face."""
    places = np.where(index < 0, above + index, index - 1)
    wrong = (places < 0) | (places >= count) | (index == 0)
    if wrong.any():
        at = int(wrong.argmax())
        hint = ": indices begin at 1" if index[at] == 0 else f": the mesh has {count}"
        raise UnreadableError(
            f"line {number[at]}: face refers to a {what} that does not exist ({index[at]}){hint}"
        )
    return places
