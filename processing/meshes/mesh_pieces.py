"""Bytes of .ply and .stl files, piece by piece."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig.arrays import Float32, Integer, UInt8, Void

Piece = bytes | memoryview


@dataclass(frozen=True)
class PlyForm:
    """What the vertices of a .ply file have.

    Parameters
    ----------
    unit
        Unit of the vertices.
    normals, colours
        Whether they have normals and colours.
    """

    unit: str
    normals: bool
    colours: bool

    def header(self, vertices: int, faces: int) -> bytes:
        """Return the header of a file with these numbers of vertices and triangles."""
        header = ["ply", "format binary_little_endian 1.0", f"comment unit {self.unit}"]
        header += [f"element vertex {vertices}"]
        header += [f"property float {name}" for name in self._names()]
        if self.colours:
            header += [f"property uchar {name}" for name in ("red", "green", "blue")]
        header += [f"element face {faces}", "property list uchar int vertex_indices"]
        header += ["end_header", ""]
        return "\n".join(header).encode("ascii")

    def vertices(
        self, points: Float32, normals: Float32 | None, colours: UInt8 | None
    ) -> memoryview:
        """Return vertices ``(N, 3)`` with their normals and colours."""
        kinds: list[tuple[str, str, tuple[int, ...]]] = [("floats", "<f4", (len(self._names()),))]
        if self.colours:
            kinds.append(("colours", "u1", (3,)))
        rows = np.zeros(len(points), kinds)
        rows["floats"][:, :3] = points
        if normals is not None:
            rows["floats"][:, 3:] = normals
        if colours is not None:
            rows["colours"] = colours
        return _bytes(rows)

    def faces(self, corners: Integer) -> memoryview:
        """Return triangles from the numbers of their vertices ``(N, 3)``."""
        faces = np.zeros(len(corners), [("count", "u1"), ("index", "<i4", (3,))])
        faces["count"], faces["index"] = 3, corners
        return _bytes(faces)

    def _names(self) -> list[str]:
        return ["x", "y", "z", *(["nx", "ny", "nz"] if self.normals else [])]


def stl_header(unit: str, faces: int) -> bytes:
    """Return the first 84 bytes of a file with a number of triangles."""
    # The header must not begin with "solid": readers would take it for a text file.
    head = f"binary triangle mesh, unit {unit}".encode().ljust(80)
    return head + faces.to_bytes(4, "little")


def stl_facets(corners: Float32) -> memoryview:
    """Return triangles from the points of their corners ``(N, 3, 3)``."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.sqrt(np.einsum("ij,ij->i", cross, cross))[:, None]
    kinds = [("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    facets = np.zeros(len(corners), kinds)
    facets["normal"] = np.where(length > 0, cross / np.where(length > 0, length, 1), 0)
    facets["corners"] = corners
    return _bytes(facets)


def _bytes(rows: Void) -> memoryview:
    return rows.view(np.uint8).data
