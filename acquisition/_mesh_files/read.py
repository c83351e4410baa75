"""One reader for all formats of meshes and point clouds."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any, Final

import numpy as np

from acquisition._errors import DataError, convert_read_errors
from acquisition._mesh_files.glb import shape_of_glb
from acquisition._mesh_files.mesh_file import MeshFile
from acquisition._mesh_files.numbers import numbers_of
from acquisition._mesh_files.ply import read_ply
from acquisition._mesh_files.stl import read_stl
from acquisition._text_files import text_of
from rig import MAX_BINARY_BYTES, UnreadableError, convert_parser_errors, read_bounded, read_head

MESH_SUFFIXES: Final = (".obj", ".ply", ".stl", ".glb", ".off", ".xyz")
# With larger coordinates, areas and lengths would overflow.
_LARGEST: Final = 1e30
_LONG_NUMBER = re.compile(rb"\d{300}")


def read_mesh_file(path: str | Path) -> MeshFile:
    r"""Read a triangle mesh or a point cloud.

    Parameters
    ----------
    path
        OBJ, PLY, STL, GLB or OFF file; or XYZ, a text of ``x y z`` or ``x y z nx ny nz`` lines.

    Returns
    -------
    MeshFile
        Content of the file; polygons and triangle strips are split into triangles.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is of another kind, damaged or truncated, or has coordinates above 1e30.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition import read_mesh_file
    >>> _ = Path("corner.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    >>> read_mesh_file("corner.obj")
    MeshFile(vertices=float64[3, 3], faces=int64[1, 3])
    """
    file = Path(path)
    with convert_read_errors(file):
        read_head(file, 0)  # a missing file is reported before a wrong suffix
    suffix = file.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise DataError(f"{file}: {suffix or 'no suffix'}: give one of {', '.join(MESH_SUFFIXES)}")
    with convert_read_errors(file):
        data = read_bounded(file, MAX_BINARY_BYTES)
        match suffix:
            case ".ply":
                mesh = read_ply(data)
            case ".stl":
                mesh = read_stl(data)
            case ".xyz":
                mesh = _xyz(data)
            case ".glb":
                mesh = _by_library(shape_of_glb(data), suffix)
            case _:
                _check_text(data, suffix)
                # For other encodings trimesh needs a package that is not installed.
                mesh = _by_library(text_of(data).encode(), suffix)
        far = np.abs(mesh.vertices) > _LARGEST
        if (far & np.isfinite(mesh.vertices)).any():
            raise UnreadableError(
                f"vertex {int(far.any(axis=1).argmax())} has a coordinate beyond {_LARGEST:g}"
            )
    return mesh


def _by_library(data: bytes, suffix: str) -> MeshFile:
    # Importing trimesh takes long.
    import trimesh

    with (
        convert_parser_errors("not readable as a mesh: damaged or truncated"),
        np.errstate(all="ignore"),
    ):
        # From memory: with a file name trimesh would look for material files in its folder.
        loaded: Any = trimesh.load(
            io.BytesIO(data), file_type=suffix[1:], process=False, skip_materials=True
        )
        if isinstance(loaded, trimesh.Scene):
            loaded = loaded.to_mesh()
        vertices = np.asarray(loaded.vertices, np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(loaded, "faces", np.zeros((0, 3))), np.int64).reshape(-1, 3)
    return MeshFile(vertices, faces if len(faces) else None)


def _check_text(data: bytes, suffix: str) -> None:
    """Refuse an OBJ or OFF file with invalid numbers, or an OFF file with too few lines."""
    if b"\0" in data or _LONG_NUMBER.search(data):
        raise UnreadableError("not a text of vertices and faces")
    if suffix != ".off":
        return
    lines = [words for line in data.splitlines() if (words := line.partition(b"#")[0].split())]
    head = [word for words in lines[:2] for word in words]
    counts = [word for word in head if word.upper() != b"OFF"][:2]
    if len(counts) < 2 or not all(re.fullmatch(rb"[0-9]{1,10}", count) for count in counts):
        raise UnreadableError("its header has no counts of vertices and faces")
    expected = int(counts[0]) + int(counts[1])
    actual = len(lines) - (2 if lines[0] == [b"OFF"] else 1)
    if actual < expected:
        raise UnreadableError(
            f"truncated: its header states {expected} lines of vertices and faces, it has "
            f"{actual}: get the complete file"
        )


def _xyz(data: bytes) -> MeshFile:
    lines = [line for line in data.replace(b",", b" ").splitlines() if line.strip()]
    lines = [line for line in lines if not line.startswith(b"#")]
    if not lines:
        raise UnreadableError("the point cloud has no points")
    columns = len(lines[0].split())
    if columns < 3:
        raise UnreadableError(f"lines of {columns} numbers, expected x y z or x y z nx ny nz")
    wrong = next((line for line in lines if len(line.split()) != columns), None)
    if wrong is not None:
        shown = wrong[:40].decode("ascii", "backslashreplace")
        raise UnreadableError(
            f"not a table of x y z lines: {shown!r} does not have {columns} numbers"
        )
    try:
        table = numbers_of(b"\n".join(lines)).reshape(-1, columns)
    except UnreadableError as error:
        raise UnreadableError(f"not a table of x y z lines: {error}") from error
    return MeshFile(table[:, :3], None, table[:, 3:6] if columns >= 6 else None)
