"""One reader for all formats of meshes and point clouds."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from acquisition._errors import DataError, convert_read_errors
from acquisition.files.text_files import text_of
from acquisition.mesh_files.glb import read_glb
from acquisition.mesh_files.mesh_file import MeshFile
from acquisition.mesh_files.obj import read_obj
from acquisition.mesh_files.off import read_off
from acquisition.mesh_files.ply import read_ply
from acquisition.mesh_files.stl import read_stl
from acquisition.mesh_files.xyz import read_xyz
from rig import UnreadableError, read_bounded
from rig.files import MAX_BINARY_BYTES, read_head

_READERS: Final = {
    ".obj": read_obj, ".ply": read_ply, ".stl": read_stl, ".glb": read_glb, ".off": read_off,
    ".xyz": read_xyz,
}  # fmt: skip
MESH_SUFFIXES: Final = tuple(_READERS)
_TEXTS: Final = (".obj", ".off")
# With larger coordinates, areas and lengths would overflow.
_LARGEST: Final = 1e30
_LONG_NUMBER = re.compile(rb"\d{300}")


def read_mesh_file(path: str | Path) -> MeshFile:
    r"""Read a triangle mesh or a point cloud.

    Parameters
    ----------
    path
        OBJ, PLY, STL, GLB or OFF file; or XYZ, a text of ``x y z`` or ``x y z nx ny nz`` lines,
        whose numbers may have decimal commas.

    Returns
    -------
    MeshFile
        Content of the file; polygons and triangle strips are split into triangles. Of a GLB, all
        that its scene shows, with the transformations of the nodes.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is of another kind, damaged or truncated, has data beyond the counts that it
        states or of a kind that is not supported, or has coordinates above 1e30.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition.mesh_files import read_mesh_file
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
    # Vertices that are not finite are reported later.
    with convert_read_errors(file), np.errstate(all="ignore"):
        data = read_bounded(file, MAX_BINARY_BYTES)
        mesh = _READERS[suffix](_text_of(data) if suffix in _TEXTS else data)
        far = np.abs(mesh.vertices) > _LARGEST
        if (far & np.isfinite(mesh.vertices)).any():
            raise UnreadableError(
                f"vertex {int(far.any(axis=1).argmax())} has a coordinate beyond {_LARGEST:g}"
            )
    return mesh


def _text_of(data: bytes) -> bytes:
    """Return a text in UTF-8; refuse zero bytes and numbers without end."""
    if b"\0" in data or _LONG_NUMBER.search(data):
        raise UnreadableError("not a text of vertices and faces")
    return text_of(data).encode()
