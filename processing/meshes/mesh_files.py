"""Mesh files for other programs.

Every format is written directly from arrays. The same surface always gives the same bytes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from acquisition import DataError, MapRows, write_durably, write_png
from acquisition.files import write_pieces
from processing.meshes.glb import glb
from processing.meshes.mesh import Mesh, check_cover, height_mesh
from processing.meshes.mesh_pieces import Piece, PlyForm, stl_facets, stl_header
from processing.meshes.mesh_rows import complete_mesh
from processing.stages.stage import NormalRows
from processing.surface.height_map import HeightMap
from rig import check_type
from rig.arrays import Bool, Generic, UInt8

# Number of lines of a text, or of vertices and faces, that are encoded at once; it limits the
# memory.
_LINES = 1 << 16


def write_mesh(
    path: str | os.PathLike[str],
    height_map: HeightMap,
    *,
    normals: NormalRows | None = None,
    colours: MapRows | None = None,
    normal_texture: bool = False,
    mesh: Mesh | None = None,
) -> tuple[Path, ...]:
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
    colours
        ``(H, W)`` or ``(H, W, 3)`` uint8 sRGB, for example of `albedo_picture`: colours of the
        vertices in a .ply, a texture in a .glb, a material with a texture in ``name.mtl`` and
        ``name_albedo.png`` next to an .obj. An .stl has no colours.
    normal_texture
        Store the normals of a .glb as a texture of 8 bits instead of at its vertices, for programs
        that simplify the mesh. A normal map of glTF is relative to the vertices, whose normals are
        then all (0, 0, 1), with tangents to the right.
    mesh
        Another mesh of this surface instead of the complete one: `height_mesh` with fewer
        triangles, or `solid_mesh`. Its vertices have their own normals and colours.

    Returns
    -------
    tuple[Path, ...]
        The files that were written, the mesh first.

    Raises
    ------
    DataError
        If the suffix is unknown, a texture of normals is requested without normals, or for the
        reasons given in `height_mesh`.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, integrate, write_mesh
    >>> y, x = np.mgrid[1:-1:5j, -1:1:5j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> [path.name for path in write_mesh("bowl.ply", integrate(bowl, pixel_mm=0.5), normals=bowl)]
    ['bowl.ply']
    """
    check_type("height_map", height_map, HeightMap, "integrate(normal_map) returns one")
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".ply", ".obj", ".stl", ".glb"):
        raise DataError(
            f"{path}: unknown mesh format {path.suffix!r}: use .ply, .obj, .stl or .glb"
        )
    if normal_texture and normals is None:
        raise DataError(f"{path}: a texture of normals requires normals")
    if mesh is None and suffix in (".ply", ".stl"):
        check_cover(height_map.mask, normals, colours)
        write_pieces(path, complete_mesh(height_map, suffix, normals, colours))
        return (path,)
    if mesh is None:
        mesh = height_mesh(height_map, normals=normals, colours=colours)
    texture = None if colours is None else textured(colours[:], height_map.mask)
    if suffix == ".obj" and texture is not None:
        return _write_textured_obj(path, mesh, texture)
    encode: dict[str, Callable[[Mesh], Iterable[Piece]]]
    encode = {".ply": _ply, ".obj": _obj, ".stl": _stl}
    parts: Iterable[Piece]
    if suffix != ".glb":
        parts = encode[suffix](mesh)
    elif normal_texture and normals is not None:
        parts = glb(mesh, texture, _normal_samples(normals))
    else:
        parts = glb(mesh, texture)
    write_pieces(path, parts)
    return (path,)


def _normal_samples(normals: NormalRows) -> UInt8:
    vectors = np.where(normals.mask[..., None], normals.normals[:], np.array([0, 0, 1], np.float32))
    samples: UInt8 = np.rint((vectors * 0.5 + 0.5) * 255).astype(np.uint8)
    return samples


def textured(colours: UInt8, mask: Bool) -> UInt8:
    """Return a texture: the colours, with their mean outside the mask.

    Programs average neighbouring pixels of a texture; black ones would darken the outline.
    """
    texture = colours.copy()
    texture[~mask] = np.rint(colours[mask].mean(axis=0))
    return texture


def _write_textured_obj(path: Path, mesh: Mesh, texture: UInt8) -> tuple[Path, ...]:
    material, image = path.with_suffix(".mtl"), path.with_name(f"{path.stem}_albedo.png")
    lines = ["newmtl surface", "Ka 0 0 0", "Kd 1 1 1", "Ks 0 0 0", "illum 1"]
    write_png(image, texture, srgb=True)
    write_durably(material, "\n".join([*lines, f"map_Kd {image.name}", ""]).encode())
    write_pieces(path, _obj(mesh, material.name))
    return path, material, image


def _ply(mesh: Mesh) -> Iterator[Piece]:
    normals, colours = mesh.normals, mesh.colours
    form = PlyForm(mesh.unit, normals is not None, colours is not None)
    yield form.header(len(mesh.vertices), len(mesh.faces))
    for part in _rows(mesh.vertices):
        yield form.vertices(
            mesh.vertices[part],
            None if normals is None else normals[part],
            None if colours is None else colours[part],
        )
    for part in _rows(mesh.faces):
        yield form.faces(mesh.faces[part])


def _stl(mesh: Mesh) -> Iterator[Piece]:
    yield stl_header(mesh.unit, len(mesh.faces))
    for part in _rows(mesh.faces):
        yield stl_facets(mesh.vertices[mesh.faces[part]])


def _rows(table: Generic) -> Iterator[slice]:
    """Yield the rows of a table in parts: a copy of a large mesh would take much memory."""
    for begin in range(0, len(table), _LINES):
        yield slice(begin, begin + _LINES)


def _obj(mesh: Mesh, material: str | None = None) -> Iterator[Piece]:
    yield f"# unit {mesh.unit}\n".encode()
    if material is not None:
        yield f"mtllib {material}\nusemtl surface\n".encode()
    yield from _text("v %.7g %.7g %.7g", mesh.vertices)
    corner, width = "%d", 1
    if material is not None and mesh.places is not None:
        # The origin of a texture is at its lower left.
        upward = np.stack([mesh.places[:, 0], 1 - mesh.places[:, 1]], axis=1)
        yield from _text("vt %.7g %.7g", upward)
        corner, width = "%d/%d", 2
    if mesh.normals is not None:
        yield from _text("vn %.5g %.5g %.5g", mesh.normals)
        corner, width = ("%d//%d", 2) if width == 1 else ("%d/%d/%d", 3)
    for part in _rows(mesh.faces):
        index = np.repeat(mesh.faces[part].astype(np.int64) + 1, width, axis=1)
        yield from _text(f"f {corner} {corner} {corner}", index)


def _text(line: str, table: Generic) -> Iterator[bytes]:
    """Format the rows of a table, one line each."""
    for part in _rows(table):
        rows = table[part]
        yield ((line + "\n") * len(rows) % tuple(rows.ravel().tolist())).encode("ascii")
