"""Readers of triangle meshes and point clouds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from acquisition import DataError
from acquisition.mesh_files import MeshFile, read_mesh_file
from processing.projection.mesh_kernels import edge_faults, half_edges, joined_vertices
from rig import Notice, short_repr
from rig.arrays import AnyArray, Bool, Float32, Float64, Floating, Int32, Int64

_CLOUDS = (".ply", ".xyz")
# Normals in a file deviate from unit length only by rounding; colours are not unit vectors.
_UNIT_TOLERANCE = 0.02
# Steps of coordinates, relative to the distance of points, that tilt normals by a degree.
_COARSE = 0.05
# Extent of the faces, relative to that of all vertices, below which faces may be missing.
_LEAST_REACH = 0.9


def counted(notice: Notice, count: int) -> list[Notice]:
    """Return a notice about what was changed or left out with its number, unless that is 0."""
    return [replace(notice, text=f"{notice.text}: {count}")] if count else []


def _wind_alike(faces: Int32) -> tuple[Int32, int, int]:
    """Reverse faces whose winding is opposite to that of their neighbours.

    Normals that are blended over faces of opposite winding cancel out or point inwards. In each
    connected part the minority is reversed. Edges with more than two faces connect no faces.

    Parameters
    ----------
    faces
        ``(F, 3)`` vertex indices. Faces that contain a vertex twice do not count.

    Returns
    -------
    tuple
        The faces in their original order, the number of reversed ones, and the number of edges with
        more than two faces.
    """
    a, b, c = faces.T
    crowded, unlike = edge_faults(np.ascontiguousarray(faces, np.int32))
    if not unlike:
        return faces, 0, crowded
    whole = np.flatnonzero((a != b) & (b != c) & (c != a))
    against = np.zeros(len(faces), np.bool_)
    against[whole] = _against(half_edges(faces[whole])[0], faces[whole].sum(axis=1, dtype=np.int64))
    return np.where(against[:, None], faces[:, ::-1], faces), int(against.sum()), crowded


def _first_of_twins(faces: Int32) -> Bool:
    """Return the mask of the faces that do not repeat an earlier one, in either winding."""
    a, b, c = np.sort(faces, axis=1).T
    order = np.lexsort((c, b, a))  # stable: the first of equal faces remains first
    same = np.zeros(len(faces), np.bool_)
    same[1:] = (np.diff(np.stack([a, b, c])[:, order]) == 0).all(axis=0)
    first = np.ones(len(faces), np.bool_)
    first[order[same]] = False
    return first


def neighbours(codes: Int64) -> tuple[Int64, Int64]:
    """Return the places in `codes` of the pairs of half-edges on edges that have two faces."""
    order = np.argsort(codes, kind="stable")
    edges = codes[order] >> 1
    same = np.concatenate([[False], edges[1:] == edges[:-1], [False]])
    pair = np.flatnonzero(same[1:-1] & ~same[:-2] & ~same[2:])
    return order[pair], order[pair + 1]


def _against(codes: Int64, totals: Int64) -> Bool:
    """Return the faces whose winding is opposite to that of the majority of their part.

    Parameters
    ----------
    codes
        ``(3 F,)`` codes of half-edges from `half_edges`.
    totals
        ``(F,)`` sums of the vertex indices of each face.
    """
    count = len(totals)
    first, second = neighbours(codes)
    # Neighbours with the same winding traverse their common edge in opposite directions.
    unlike = codes[first] == codes[second]
    first, second = first % count, second % count
    # Duplicate faces also share the third corner and are not neighbours.
    apart = totals[first] != totals[second]
    first, second, unlike = first[apart], second[apart], unlike[apart]
    # The graph contains every face twice, in its own and in reversed orientation, and connects
    # neighbours of consistent orientation.
    begin = np.concatenate([first, first + count])
    end = np.concatenate([second, second + count]) + count * np.concatenate([unlike, -1 * unlike])
    links = coo_array((np.ones(len(begin), np.int8), (begin, end)), shape=(2 * count, 2 * count))
    _, part = connected_components(links, directed=False)
    here, there = part[:count], part[count:]
    side = here > there
    name = np.minimum(here, there)
    fewer = 2 * np.bincount(name, side) > np.bincount(name)
    # A Moebius strip has only one side, so no orientation is wrong.
    return np.asarray((side ^ fewer[name]) & (here != there))


@dataclass(frozen=True, eq=False)
class Geometry:
    """A triangle mesh or a point cloud, in the axes and the unit of its file.

    Parameters
    ----------
    vertices
        ``(V, 3)`` float64, finite.
    faces
        ``(F, 3)`` int32 vertex indices, counter-clockwise as seen from outside; None for points.
    normals
        ``(V, 3)`` float64 unit vectors of points, ``(F, 3, 3)`` float32 ones of the corners of
        faces, NaN where unknown, or None.
    warnings
        Faces and points that were changed or left out.

    Raises
    ------
    DataError
        If there is no vertex, a mesh has no face, a vertex is not finite, or a face refers to a
        vertex that does not exist.
    """

    vertices: Float64
    faces: Int32 | None = None
    normals: Floating | None = None
    warnings: tuple[Notice, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not len(vertices):
            raise DataError(f"vertices of shape {vertices.shape}, expected (V, 3) with V > 0")
        finite = np.isfinite(vertices).all(axis=1)
        if not finite.all():
            raise DataError(
                f"vertex {int(finite.argmin())} is not finite, "
                f"{vertices[finite.argmin()].tolist()}: repair the mesh"
            )
        object.__setattr__(self, "vertices", vertices)
        if self.faces is None:
            return
        faces = np.asarray(self.faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise DataError(f"faces of shape {faces.shape}, expected (F, 3) with F > 0")
        if faces.min() < 0 or faces.max() >= len(vertices):
            wrong = int(((faces < 0) | (faces >= len(vertices))).any(axis=1).argmax())
            raise DataError(
                f"face {wrong} refers to a vertex that does not exist: the mesh has "
                f"{len(vertices)} vertices"
            )
        object.__setattr__(self, "faces", np.ascontiguousarray(faces, np.int32))


def read_geometry(path: str | Path) -> Geometry:
    r"""Read a triangle mesh or a point cloud.

    Parameters
    ----------
    path
        A mesh as OBJ, PLY, STL, GLB or OFF; polygons and triangle strips are split into triangles.
        A point cloud as PLY without faces or as XYZ, a text file with ``x y z`` or
        ``x y z nx ny nz`` lines.

    Returns
    -------
    Geometry
        Vertices of a mesh with equal coordinates are merged, so that normals blend across texture
        seams and between the separate faces of an STL; unused vertices are removed. Faces whose
        winding is opposite to that of their neighbours are reversed, and faces that repeat others
        are left out. Points that are not finite, which scanners write for a miss, are left out. A
        warning reports these, edges with more than two faces, vertices beyond all faces, and
        coordinates that are too coarse for the points.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file has another format, is damaged or truncated, or for the reasons given in
        `Geometry`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from processing import read_geometry
    >>> _ = Path("corner.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    >>> read_geometry("corner.obj").vertices.shape
    (3, 3)
    """
    mesh = read_mesh_file(path)
    try:
        if mesh.faces is None:
            if Path(path).suffix.lower() not in _CLOUDS:
                raise DataError("the mesh has no faces: use .ply or .xyz files for point clouds")
            return _cloud(mesh)
        return _mesh(mesh, mesh.faces)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _mesh(mesh: MeshFile, faces: AnyArray) -> Geometry:
    # This also rejects indices that exceed 32 bits.
    checked = Geometry(mesh.vertices, faces)
    joined, corners = _joined(checked.vertices, faces)
    warnings = list(mesh.warnings)
    reach, used = (np.ptp(points, axis=0) for points in (checked.vertices, joined))
    if (used < _LEAST_REACH * reach).any():
        text = (
            "the faces do not reach as far as the vertices of the file: "
            f"{' x '.join(f'{span:.4g}' for span in used)} instead of "
            f"{' x '.join(f'{span:.4g}' for span in reach)}; faces may be missing"
        )
        warnings.append(Notice("vertices-unused", text))
    normals = _corner_normals(mesh.normals, faces)
    if edge_faults(corners)[0]:
        single = _first_of_twins(corners)
        text = "faces left out because they repeat others"
        warnings += counted(Notice("faces-doubled", text), int((~single).sum()))
        corners, normals = corners[single], None if normals is None else normals[single]
    wound = corners
    corners, turned, crowded = _wind_alike(wound)
    if normals is not None and turned:
        against = (corners != wound).any(axis=1)
        normals[against] = normals[against, ::-1]
    if crowded:
        text = (
            f"edges with more than two faces: {crowded}; the mesh is not a manifold and is drawn "
            "without repair"
        )
        warnings.append(Notice("mesh-not-manifold", text))
    text = "faces reversed to match the winding of their neighbours"
    warnings += counted(Notice("faces-reversed", text), turned)
    return Geometry(joined, corners, normals, (*warnings, *_coarse(joined)))


def _corner_normals(normals: Float64 | None, faces: Int64) -> Float32 | None:
    """Return the normals of vertices as unit vectors at the corners of the faces."""
    if normals is None:
        return None
    with np.errstate(all="ignore"):
        unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(unit, np.float32)[faces]


def _coarse(points: Float64) -> tuple[Notice, ...]:
    """Return a notice if the coordinates were stored with too few digits for the points.

    Numbers of 32 bits have 24 binary digits, which an offset to a map's origin uses up.
    """
    single = points.astype(np.float32)
    if len(points) < 4 or (single != points).any():
        return ()
    step = float(np.spacing(np.abs(single).max()))
    spans = np.sort(np.ptp(points, axis=0))
    apart = float(np.sqrt(spans[1] * spans[2] / len(points)))
    if step < _COARSE * apart:
        return ()
    text = (
        f"coordinates up to {np.abs(points).max():.7g} are stored in steps of {step:.3g}, and "
        f"points are about {apart:.3g} apart: normals are inaccurate; subtract an offset before "
        "saving numbers of 32 bits"
    )
    return (Notice("coordinates-coarse", text),)


def _joined(vertices: Float64, faces: Int64) -> tuple[Float64, Int32]:
    """Merge vertices with equal coordinates, and remove those that no face uses."""
    used = np.zeros(len(vertices), np.bool_)
    used[faces] = True
    # Keep the order of the file: the first vertex at each position keeps its place, so vertices
    # that are close in the file remain close in memory.
    kept, number = joined_vertices(vertices, used)
    return vertices[kept], number[faces]


def _cloud(mesh: MeshFile) -> Geometry:
    points = mesh.vertices
    finite = np.isfinite(points).all(axis=1)
    warnings = list(mesh.warnings)
    text = "points left out because they are not finite"
    warnings += counted(Notice("points-not-finite", text), int((~finite).sum()))
    if not finite.any():
        raise DataError("the point cloud has no finite point")
    normals = None if mesh.normals is None else mesh.normals[finite]
    if normals is not None:
        # Exclude large vectors first; the square of their length would overflow.
        short = (np.abs(normals) < 2).all(axis=1, keepdims=True)
        length = np.linalg.norm(np.where(short, normals, 0), axis=1)
        off = ~(np.abs(length - 1) < _UNIT_TOLERANCE)
        if off.any():
            text = (
                f"{off.sum()} of {len(off)} points {'has' if off.sum() == 1 else 'have'} a normal "
                "that is not a unit vector (or a colour): all normals are fitted to the points "
                "instead"
            )
            warnings.append(Notice("point-normals-not-unit", text))
            normals = None
    return Geometry(points[finite], None, normals, (*warnings, *_coarse(points[finite])))
