"""Triangle meshes and point clouds from files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from acquisition import DataError, MissingPathError
from processing._projection.manifold import wind_alike

Double = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int32]

_SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".off", ".xyz")
# Normals of a file are off unit length by their digits only; colours are not unit vectors.
_UNIT_TOLERANCE = 0.02
# More than the counts at the head of an OFF take.
_HEADER_BYTES = 256


@dataclass(frozen=True, eq=False)
class Geometry:
    """A triangle mesh or a point cloud, in the axes and the unit of its file.

    Parameters
    ----------
    vertices
        ``(V, 3)`` float64, finite.
    faces
        ``(F, 3)`` int32 vertex numbers, counter-clockwise seen from outside; None for points.
    normals
        ``(V, 3)`` float64 unit vectors that came with the points, or None.
    warnings
        What the reader should know, a line each.

    Raises
    ------
    DataError
        If there is no vertex, a mesh has no face, a vertex is not finite, or a face names a vertex
        that is not there.
    """

    vertices: Double
    faces: Whole | None = None
    normals: Double | None = None
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not len(vertices):
            raise DataError(f"vertices of shape {vertices.shape}, expected (V, 3) with V above 0")
        finite = np.isfinite(vertices).all(axis=1)
        if not finite.all():
            raise DataError(
                f"vertex {int(finite.argmin())} is {vertices[finite.argmin()].tolist()}, not "
                "finite: mend the mesh"
            )
        object.__setattr__(self, "vertices", vertices)
        if self.faces is None:
            return
        faces = np.asarray(self.faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise DataError(f"faces of shape {faces.shape}, expected (F, 3) with F above 0")
        if faces.min() < 0 or faces.max() >= len(vertices):
            wrong = int(((faces < 0) | (faces >= len(vertices))).any(axis=1).argmax())
            raise DataError(
                f"face {wrong} names a vertex that is not there, the mesh has {len(vertices)}"
            )
        object.__setattr__(self, "faces", np.ascontiguousarray(faces, np.int32))


def read_geometry(path: str | Path) -> Geometry:
    """Read a triangle mesh or a point cloud.

    Parameters
    ----------
    path
        A mesh as OBJ, PLY, STL, GLB or OFF, polygons being cut into triangles; a point cloud as PLY
        without faces or as XYZ, a text of ``x y z`` or ``x y z nx ny nz`` lines.

    Returns
    -------
    Geometry
        Vertices of a mesh that lie in one place are one, so that normals blend over the seams of
        textures and between the loose faces of an STL; those that no face uses are left out. Faces
        that wind against their neighbours are turned round and told; edges of more than two faces
        are told. Points that are not finite, as scanners write for a miss, are left out and told.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If it is of another kind, damaged, truncated, or see `Geometry`.
    """
    file = Path(path)
    if file.is_dir():
        raise DataError(f"{file}: a folder, not a mesh: give one of {', '.join(_SUFFIXES)}")
    if not file.is_file():
        raise MissingPathError(f"{file}: there is no such mesh or point cloud file")
    suffix = file.suffix.lower()
    if suffix not in _SUFFIXES:
        raise DataError(f"{file}: {suffix or 'no suffix'}: give one of {', '.join(_SUFFIXES)}")
    try:
        if suffix == ".xyz":
            return _cloud(_xyz(file))
        return _mesh(file, suffix)
    except DataError as error:
        raise DataError(f"{file}: {error}") from error


def _mesh(file: Path, suffix: str) -> Geometry:
    if suffix == ".stl":
        _check_stl(file)
    if suffix in (".off", ".ply"):
        _check_lines(file)
    try:
        loaded: Any = trimesh.load(file, process=False)
        if isinstance(loaded, trimesh.Scene):
            loaded = loaded.to_mesh()
    # Whatever a damaged file provokes in the reader.
    except Exception as error:
        reason = " ".join(str(error).split())[:120]
        raise DataError(f"not readable as a mesh, is it whole? ({reason})") from error
    vertices = np.asarray(loaded.vertices, np.float64)
    faces = np.asarray(getattr(loaded, "faces", np.zeros((0, 3))), np.int64)
    if not len(faces):
        if suffix != ".ply":
            raise DataError("the mesh has no faces: point clouds are read from .ply and .xyz")
        return _cloud(np.concatenate([vertices, *_ply_normals(loaded, len(vertices))], axis=1))
    checked = Geometry(vertices, faces.astype(np.int32))
    joined, corners = _joined(checked.vertices, faces)
    corners, turned, crowded = wind_alike(corners)
    warnings = []
    if crowded:
        warnings.append(
            f"edges where more than two faces meet (no manifold): {crowded}; it is drawn as it is"
        )
    if turned:
        warnings.append(f"faces turned round as they wind against their neighbours: {turned}")
    return Geometry(joined, corners, warnings=tuple(warnings))


def _joined(vertices: Double, faces: npt.NDArray[np.int64]) -> tuple[Double, Whole]:
    """Make one vertex of those in one place, and leave out those that no face uses."""
    used = np.zeros(len(vertices), np.bool_)
    used[faces] = True
    order = np.lexsort(vertices.T)
    order = order[used[order]]
    ordered = vertices[order]
    new = np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(axis=1)])
    # The first of each place in the order of the file keeps its turn: near in the file, near in
    # memory.
    first = np.minimum.reduceat(order, np.flatnonzero(new))
    kept = np.sort(first)
    number = np.zeros(len(vertices), np.int32)
    number[order] = np.searchsorted(kept, first)[np.cumsum(new) - 1]
    return vertices[kept], number[faces]


def _cloud(table: Double) -> Geometry:
    points, normals = table[:, :3], table[:, 3:6]
    finite = np.isfinite(points).all(axis=1)
    warnings = []
    if not finite.all():
        warnings.append(f"points left out as not finite: {int((~finite).sum())}")
    if not finite.any():
        raise DataError("the point cloud holds no finite point")
    normals = normals[finite]
    if normals.shape[1] == 3:
        off = ~(np.abs(np.linalg.norm(normals, axis=1) - 1) < _UNIT_TOLERANCE)
        if off.any():
            warnings.append(
                f"of {len(off)} points {int(off.sum())} come with a normal that is no unit vector "
                "(or a colour): all normals are fitted anew"
            )
            normals = normals[:, :0]
    known = normals if normals.shape[1] == 3 else None
    return Geometry(points[finite], None, known, tuple(warnings))


def _xyz(file: Path) -> Double:
    try:
        text = file.read_text(encoding="utf-8").replace(",", " ")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"not a text of points ({error})") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise DataError("the point cloud holds no point")
    try:
        table: Double = np.loadtxt(lines, ndmin=2)
    except ValueError as error:
        raise DataError(f"not a table of x y z lines ({str(error).split(';')[0]})") from error
    if table.shape[1] < 3:
        raise DataError(f"lines of {table.shape[1]} numbers, expected x y z or x y z nx ny nz")
    return table


def _ply_normals(loaded: Any, count: int) -> list[Double]:
    """Return the normals of a PLY's points, where it has them."""
    raw = loaded.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    names = raw.dtype.names if isinstance(raw, np.ndarray) else raw
    if names is None or not {"nx", "ny", "nz"} <= set(names):
        return []
    columns = [np.reshape(raw[name], (count, 1)) for name in ("nx", "ny", "nz")]
    return [np.concatenate(columns, axis=1).astype(np.float64)]


def _check_lines(file: Path) -> None:
    """Refuse an OFF or a PLY of text that has fewer lines than its header promises."""
    content = file.read_bytes()
    if file.suffix.lower() == ".ply":
        head, _, body = content.partition(b"end_header")
        if b"format ascii" not in head:
            return
        counts = re.findall(rb"^element \w+ (\d+)", head, re.M)
    else:
        body = re.sub(rb"#.*", b"", content).lstrip().removeprefix(b"OFF").lstrip()
        counts = body[:_HEADER_BYTES].split()[:2]
        body = body.partition(b"\n")[2]
    promised = sum(int(count) for count in counts if count.isdigit())
    held = sum(bool(line.strip()) for line in body.splitlines())
    if held < promised:
        raise DataError(
            f"truncated: its header promises {promised} lines of vertices and faces, it holds "
            f"{held}: get the whole file"
        )


def _check_stl(file: Path) -> None:
    """Refuse what is neither a text nor of the length that a binary STL announces."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        head = stream.read(84)
    if head.lstrip()[:5].lower() == b"solid":
        return
    if len(head) < 84 or size < 84 + 50 * int.from_bytes(head[80:84], "little"):
        raise DataError("truncated: shorter than its header says: get the whole file")
