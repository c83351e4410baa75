"""OBJ files: polygons with positive or negative indices, and normals of corners.

Format: Wavefront, Advanced Visualizer manual, appendix B1 (1995).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition._mesh_files.mesh_file import MeshFile
from acquisition._mesh_files.numbers import numbers_of, whole
from acquisition._mesh_files.polygons import triangles_of
from rig import UnreadableError

Double = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

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
    polygons: list[list[bytes]] = []
    # The number of the line, and how many vertices and normals are above it.
    above: list[tuple[int, int, int]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition(b"#")[0].split(None, 1)
        match words:
            case [b"v", rest]:
                points.append(rest)
            case [b"vn", rest]:
                normals.append(rest)
            case [b"f" | b"fo", rest]:
                polygons.append(rest.split())
                above.append((number, len(points), len(normals)))
            case [b"surf", _]:
                raise UnreadableError(
                    f"line {number}: free-form surfaces are not supported: save it with triangles"
                )
    vertices = _table("v", points, _VERTEX_WIDTHS)
    if not polygons:
        return MeshFile(vertices)
    lengths = np.array([len(words) for words in polygons], np.int64)
    number, *counts = np.repeat(np.array(above, np.int64), lengths, axis=0).T
    fields = _fields([word for words in polygons for word in words])
    corners = _places(fields[:, 0], counts[0], len(vertices), number, "vertex")
    if not (normals and fields[:, 2].any()):
        faces, notices = triangles_of(lengths, corners, vertices)
        return MeshFile(vertices, faces, None, notices)
    directions = np.concatenate([_table("vn", normals, (3,)), np.full((1, 3), np.nan)])
    # 0 stands for no normal, which is the last one.
    absent = fields[:, 2] == 0
    known = _places(np.where(absent, 1, fields[:, 2]), counts[1], len(normals), number, "normal")
    which = np.where(absent, len(normals), known)
    pairs, corners = np.unique(corners * len(directions) + which, return_inverse=True)
    vertices, directions = vertices[pairs // len(directions)], directions[pairs % len(directions)]
    faces, notices = triangles_of(lengths, corners.reshape(-1), vertices)
    return MeshFile(vertices, faces, directions, notices)


def _table(key: str, texts: list[bytes], widths: tuple[int, ...]) -> Double:
    """Return the first three numbers of each line."""
    counts = {len(text.split()) for text in texts}
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


def _fields(corners: list[bytes]) -> Whole:
    """Return the ``(C, 3)`` numbers of vertex, texture and normal; 0 for those that are absent."""
    slashes = {corner.count(b"/") for corner in corners}
    if slashes == {0}:
        numbers = numbers_of(b" ".join(corners))
    else:
        numbers = np.zeros(0)
        if len(slashes) == 1:
            numbers = numbers_of(b" ".join(corners).replace(b"//", b"/0/").replace(b"/", b" "))
        if len(numbers) != len(corners) * (max(slashes) + 1):
            # Corners of different forms, such as 1/2/3 and 1//3.
            parts = ((*corner.split(b"/"), b"", b"")[:3] for corner in corners)
            numbers = numbers_of(b" ".join(part or b"0" for three in parts for part in three))
    fields = whole(numbers).reshape(len(corners), -1)[:, :3]
    return np.pad(fields, ((0, 0), (0, 3 - fields.shape[1])))


def _places(index: Whole, above: Whole, count: int, number: Whole, what: str) -> Whole:
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
