"""PLY files: meshes of polygons or triangle strips, and point clouds.

Format: Greg Turk, The PLY Polygon File Format (1994). Triangle strips follow Stanford's scanning
repository: an element ``tristrips`` has a list of vertices in which -1 ends a strip.
"""

from __future__ import annotations

import numpy as np

from acquisition.mesh_files.mesh_file import MeshFile, whole
from acquisition.mesh_files.ply_body import Element, Lists, Table, read_body, read_header
from acquisition.mesh_files.polygons import triangles_of
from rig import Notice, UnreadableError
from rig.arrays import Bool, Float64, Int64

_CORNERS = ("vertex_indices", "vertex_index")
_STRIPS = "tristrips"
# Values that represent -1 in unsigned types.
_UNSIGNED_ENDS = (0xFF, 0xFFFF, 0xFFFFFFFF)


def read_ply(data: bytes) -> MeshFile:
    """Read a PLY file.

    Raises
    ------
    UnreadableError
        If the file is damaged or truncated, has no vertices, or has an unsupported kind of surface.
    """
    order, elements, begin = read_header(data)
    tables = read_body(memoryview(data)[begin:], order, elements)
    vertex = tables.get("vertex", Table({}, {}))
    if not {"x", "y", "z"} <= set(vertex.columns):
        raise UnreadableError("its header has no element vertex with x, y and z")
    normals = None
    if {"nx", "ny", "nz"} <= set(vertex.columns):
        normals = np.stack([vertex.columns[name] for name in ("nx", "ny", "nz")], axis=1)
    vertices = np.stack([vertex.columns[name] for name in "xyz"], axis=1)
    named = {element.name: element for element in elements}
    faces, warnings = _surface(named, tables, vertices)
    return MeshFile(vertices, faces, normals, warnings)


def _surface(
    elements: dict[str, Element], tables: dict[str, Table], vertices: Float64
) -> tuple[Int64 | None, tuple[Notice, ...]]:
    """Return the triangles of faces and strips, and warnings; None if the file has neither."""
    triangles: list[Int64] = []
    warnings: tuple[Notice, ...] = ()
    if "face" in elements and elements["face"].count:
        polygons = _corners(elements["face"], tables["face"])
        split, warnings = triangles_of(polygons.lengths, polygons.values, vertices)
        triangles.append(split)
    if _STRIPS in elements and elements[_STRIPS].count:
        strips = elements[_STRIPS]
        kind = next((one.kind for one in strips.lists), "i4")
        triangles.append(_of_strips(_corners(strips, tables[_STRIPS]), kind))
    if triangles:
        return np.concatenate(triangles), warnings
    for element in elements.values():
        if element.count and any(one.name in _CORNERS for one in element.lists):
            raise UnreadableError(
                f"its surface has {element.name} elements, which are not supported: save it with "
                "triangles"
            )
    return None, ()


def _corners(element: Element, table: Table) -> Lists:
    names = [one.name for one in element.lists]
    named = [name for name in names if name in _CORNERS] or names
    if len(named) != 1 or next(o for o in element.lists if o.name == named[0]).kind[0] == "f":
        raise UnreadableError(
            f"its {element.name} elements have no list of integers named vertex_indices"
        )
    corners = table.lists[named[0]]
    return Lists(corners.lengths, whole(corners.values))


def _of_strips(strips: Lists, kind: str) -> Int64:
    """Return the triangles of strips, wound like the first triangle of each strip.

    Degenerate triangles with a repeated vertex, which connect strips, are left out.
    """
    # The end of a list ends a strip, like -1.
    ends = np.cumsum(strips.lengths)[:-1]
    run = np.insert(strips.values, ends, -1)
    if kind[0] == "u":
        run[np.isin(run, _UNSIGNED_ENDS[: {"u1": 1, "u2": 2}.get(kind, 3)][-1:])] = -1
    if len(run) < 3:
        return np.zeros((0, 3), np.int64)
    place = np.arange(len(run))
    begin = np.maximum.accumulate(np.where(run == -1, place + 1, 0))
    corners = np.stack([run[:-2], run[1:-1], run[2:]], axis=1)
    odd = (place - begin)[:-2] % 2 == 1
    corners[odd] = corners[odd][:, [1, 0, 2]]
    a, b, c = corners.T
    drawn: Bool = (corners != -1).all(axis=1) & (a != b) & (b != c) & (c != a)
    return corners[drawn]
