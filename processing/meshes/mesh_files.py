"""Mesh files for other programs.

Every format is written directly from arrays. The same surface always gives the same bytes.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from acquisition import DataError, MapRows, write_durably, write_png
from acquisition.files import write_pieces
from processing.meshes.glb import glb
from processing.meshes.mesh import Mesh, check_cover, height_mesh
from processing.meshes.mesh_rows import MeshRows, complete_mesh, rows_of_mesh, rows_of_table
from processing.stages.stage import NormalRows
from processing.surface.height_map import HeightMap
from rig import check_type
from rig.arrays import Bool, Generic, UInt8, Void

Piece = bytes | memoryview


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
    in_parts = {".ply": _ply, ".stl": _stl}
    if suffix in in_parts:
        if mesh is None:
            check_cover(height_map.mask, normals, colours)
            rows = complete_mesh(height_map, normals, colours)
        else:
            rows = rows_of_mesh(mesh)
        write_pieces(path, in_parts[suffix](rows))
        return (path,)
    mesh = mesh or height_mesh(height_map, normals=normals, colours=colours)
    texture = None if colours is None else textured(colours[:], height_map.mask)
    if suffix == ".glb":
        bumps = _normal_samples(normals) if normal_texture and normals is not None else None
        write_pieces(path, glb(mesh, texture, bumps))
    elif texture is not None:
        return _write_textured_obj(path, mesh, texture)
    else:
        write_pieces(path, _obj(mesh))
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


def _ply(mesh: MeshRows) -> Iterator[Piece]:
    names = ["x", "y", "z", *(["nx", "ny", "nz"] if mesh.normals else [])]
    header = ["ply", "format binary_little_endian 1.0", f"comment unit {mesh.unit}"]
    header += [f"element vertex {mesh.vertex_count}"]
    header += [f"property float {name}" for name in names]
    kinds: list[tuple[str, str, tuple[int, ...]]] = [("floats", "<f4", (len(names),))]
    if mesh.colours:
        header += [f"property uchar {name}" for name in ("red", "green", "blue")]
        kinds += [("colours", "u1", (3,))]
    header += [f"element face {mesh.face_count}", "property list uchar int vertex_indices"]
    yield "\n".join([*header, "end_header", ""]).encode("ascii")
    for points, normals, colours in mesh.vertices:
        rows = np.zeros(len(points), kinds)
        rows["floats"][:, :3] = points
        if normals is not None:
            rows["floats"][:, 3:] = normals
        if colours is not None:
            rows["colours"] = colours
        yield _bytes(rows)
    for corners in mesh.faces:
        faces = np.zeros(len(corners), [("count", "u1"), ("index", "<i4", (3,))])
        faces["count"], faces["index"] = 3, corners
        yield _bytes(faces)


def _stl(mesh: MeshRows) -> Iterator[Piece]:
    # The header must not begin with "solid": readers would take it for a text file.
    yield f"binary triangle mesh, unit {mesh.unit}".encode().ljust(80)
    yield mesh.face_count.to_bytes(4, "little")
    for corners in mesh.facets:
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.sqrt(np.einsum("ij,ij->i", cross, cross))[:, None]
        kinds = [("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
        facets = np.zeros(len(corners), kinds)
        facets["normal"] = np.where(length > 0, cross / np.where(length > 0, length, 1), 0)
        facets["corners"] = corners
        yield _bytes(facets)


def _bytes(rows: Void) -> memoryview:
    return rows.view(np.uint8).data


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
    for part in rows_of_table(mesh.faces):
        index = np.repeat(mesh.faces[part].astype(np.int64) + 1, width, axis=1)
        yield from _text(f"f {corner} {corner} {corner}", index)


def _text(line: str, table: Generic) -> Iterator[bytes]:
    """Format the rows of a table, one line each."""
    for part in rows_of_table(table):
        rows = table[part]
        yield ((line + "\n") * len(rows) % tuple(rows.ravel().tolist())).encode("ascii")
