"""Triangle meshes of surfaces, and mesh files for other programs.

Every format is written directly from arrays. The same surface always gives the same bytes.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition import DataError, write_durably
from processing._normal_map import NormalMap
from processing._surface.integration import HeightMap
from rig import check_type, short_repr

Float = npt.NDArray[np.float32]

# The unit of glTF is the metre.
_METRES = 1e-3
# Number of lines that are formatted at once; it limits the memory for an .obj file.
_TEXT_LINES = 1 << 16


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Parameters
    ----------
    vertices
        ``(V, 3)`` float32.
    faces
        ``(F, 3)`` int32 vertex indices, counter-clockwise as seen from the camera.
    normals
        ``(V, 3)`` float32 unit vectors, or None.
    unit
        Unit of the vertices: ``mm``, or ``px`` if the scale is not known.
    """

    vertices: Float
    faces: npt.NDArray[np.int32]
    normals: Float | None = None
    unit: Literal["mm", "px"] = "px"

    __repr__ = short_repr


def height_mesh(height_map: HeightMap, *, normals: NormalMap | None = None) -> Mesh:
    """Make a mesh from a height map: one vertex per pixel of its mask, in reading order.

    Four neighbouring pixels form two triangles, split along the shorter diagonal in space; three of
    the four form one triangle. No triangle connects two parts of the surface.

    Parameters
    ----------
    height_map
        The surface.
    normals
        Normals of the vertices; the map must cover the height map's mask.

    Returns
    -------
    Mesh
        The mesh, in the unit of the height map, with normals toward the camera.

    Raises
    ------
    DataError
        If the normals do not cover the height map, or it contains no triangle.
    """
    check_type("height_map", height_map, HeightMap, "integrate(normal_map) returns one")
    mask = height_map.mask
    if normals is not None and (normals.size != mask.shape or np.any(mask & ~normals.mask)):
        raise DataError(
            "the normals do not cover the height map: give the normal map it was integrated from"
        )
    vertices = height_map.points()[mask]
    faces = _faces(height_map.parts, vertices)
    if not len(faces):
        raise DataError(
            "the surface contains no triangle: it is nowhere two pixels wide; check the mask"
        )
    facing = None if normals is None else normals.normals[mask]
    return Mesh(vertices, faces, facing, height_map.unit)


def _faces(parts: npt.NDArray[np.int32], vertices: Float) -> npt.NDArray[np.int32]:
    inside = parts >= 0
    number = np.full(parts.shape, -1, np.int32)
    number[inside] = np.arange(len(vertices), dtype=np.int32)
    # Corners of each square of pixels: a and b above d and e.
    a, b, d, e = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]

    part_of = parts[inside]

    def joined(*corners: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_]:
        # A missing corner (-1) indexes the last vertex; corner >= 0 excludes it.
        first = part_of[corners[0]]
        whole = np.ones(first.shape, np.bool_)
        for corner in corners:
            whole &= (corner >= 0) & (part_of[corner] == first)
        return whole

    adb, bde, ade, aeb = joined(a, d, b), joined(b, d, e), joined(a, d, e), joined(a, e, b)
    quads = adb & bde
    shorter_bd = np.zeros_like(quads)
    shorter_bd[quads] = _distance2(vertices, b[quads], d[quads]) <= _distance2(
        vertices, a[quads], e[quads]
    )
    split_ae = quads & ~shorter_bd
    # Squares with three corners contain one triangle; squares with four are split at a diagonal.
    triangles = [
        (adb & ~split_ae, (a, d, b)),
        (bde & ~split_ae, (b, d, e)),
        (ade & (split_ae | ~quads), (a, d, e)),
        (aeb & (split_ae | ~quads), (a, e, b)),
    ]
    return np.concatenate(
        [np.stack([corner[where] for corner in corners], axis=1) for where, corners in triangles]
    )


def _distance2(vertices: Float, a: npt.NDArray[np.int32], b: npt.NDArray[np.int32]) -> Float:
    step = vertices[a] - vertices[b]
    return np.asarray(np.einsum("ij,ij->i", step, step), np.float32)


def write_mesh(
    path: str | os.PathLike[str],
    height_map: HeightMap,
    *,
    normals: NormalMap | None = None,
) -> None:
    """Write a surface as a triangle mesh; the suffix selects the format.

    Parameters
    ----------
    path
        ``.ply`` (binary), ``.obj`` (text), ``.stl`` (binary, without vertex normals) or
        ``.glb`` (glTF 2.0, coordinates divided by 1000: metres if the unit is mm). An existing file
        is replaced. Each file names its unit: in a comment, in the header of an .stl, in
        ``asset.extras`` of a .glb.
    height_map
        The surface; all formats except .glb use its unit.
    normals
        Normals of the vertices; see `height_mesh`.

    Raises
    ------
    DataError
        If the suffix is unknown, or for the reasons given in `height_mesh`.
    StorageError
        If the file cannot be written.
    """
    check_type("height_map", height_map, HeightMap, "integrate(normal_map) returns one")
    path = Path(path)
    encode = {".ply": _ply, ".obj": _obj, ".stl": _stl, ".glb": _glb}.get(path.suffix.lower())
    if encode is None:
        raise DataError(
            f"{path}: unknown mesh format {path.suffix!r}: use .ply, .obj, .stl or .glb"
        )
    write_durably(path, *encode(height_mesh(height_map, normals=normals)))


def _ply(mesh: Mesh) -> list[bytes]:
    names = ["x", "y", "z"]
    columns = [mesh.vertices]
    if mesh.normals is not None:
        names += ["nx", "ny", "nz"]
        columns.append(mesh.normals)
    header = ["ply", "format binary_little_endian 1.0", f"comment unit {mesh.unit}"]
    header += [f"element vertex {len(mesh.vertices)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices"]
    header += ["end_header", ""]
    rows = np.concatenate(columns, axis=1).astype("<f4")
    faces = np.zeros(len(mesh.faces), [("count", "u1"), ("index", "<i4", (3,))])
    faces["count"], faces["index"] = 3, mesh.faces
    return ["\n".join(header).encode("ascii"), rows.tobytes(), faces.tobytes()]


def _stl(mesh: Mesh) -> list[bytes]:
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.sqrt(np.einsum("ij,ij->i", cross, cross))[:, None]
    facets = np.zeros(
        len(mesh.faces), [("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    facets["normal"] = np.where(length > 0, cross / np.where(length > 0, length, 1), 0)
    facets["corners"] = corners
    # The header must not begin with "solid": readers would take it for a text file.
    header = (
        f"binary triangle mesh, unit {mesh.unit}".encode().ljust(80)
        + np.uint32(len(facets)).astype("<u4").tobytes()
    )
    return [header, facets.tobytes()]


def _obj(mesh: Mesh) -> list[bytes]:
    chunks = [f"# unit {mesh.unit}\n".encode(), *_text("v %.7g %.7g %.7g", mesh.vertices)]
    corner = "%d"
    index = mesh.faces.astype(np.int64) + 1
    if mesh.normals is not None:
        chunks += _text("vn %.5g %.5g %.5g", mesh.normals)
        corner, index = "%d//%d", np.repeat(index, 2, axis=1)
    return chunks + _text(f"f {corner} {corner} {corner}", index)


def _text(line: str, table: npt.NDArray[np.generic]) -> list[bytes]:
    """Format the rows of a table, one line each."""
    return [
        ((line + "\n") * len(part) % tuple(part.ravel().tolist())).encode("ascii")
        for part in np.split(table, range(_TEXT_LINES, len(table), _TEXT_LINES))
    ]


def _glb(mesh: Mesh) -> list[bytes]:
    positions = mesh.vertices * np.float32(_METRES)
    views: list[tuple[bytes, int, dict[str, object]]] = []
    attributes = {"POSITION": 0}
    bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    vectors = {"componentType": 5126, "type": "VEC3", "count": len(positions)}
    views.append((positions.astype("<f4").tobytes(), 34962, vectors | bounds))
    if mesh.normals is not None:
        attributes["NORMAL"] = len(views)
        views.append((mesh.normals.astype("<f4").tobytes(), 34962, vectors))
    primitive = {"attributes": attributes, "indices": len(views)}
    scalars = {"componentType": 5125, "type": "SCALAR", "count": mesh.faces.size}
    views.append((mesh.faces.astype("<u4").tobytes(), 34963, scalars))
    offsets = np.cumsum([0] + [len(data) for data, _, _ in views]).tolist()
    document = {
        "asset": {"version": "2.0", "extras": {"unit": "m" if mesh.unit == "mm" else "px / 1000"}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": offsets[-1]}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": offset, "byteLength": len(data), "target": target}
            for offset, (data, target, _) in zip(offsets, views, strict=False)
        ],
        "accessors": [
            {"bufferView": number} | accessor for number, (_, _, accessor) in enumerate(views)
        ],
    }
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + offsets[-1]
    words = np.array([0x46546C67, 2, total, len(text), 0x4E4F534A], "<u4").tobytes()
    binary = np.array([offsets[-1], 0x004E4942], "<u4").tobytes()
    return [words, text, binary, *(data for data, _, _ in views)]
