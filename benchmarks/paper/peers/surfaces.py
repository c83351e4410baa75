"""The surfaces that a mesh method receives instead of two normal maps, and their normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import processing
from benchmarks.paper.peers.mesh import GridMesh
from rig.arrays import Bool, Float32


@dataclass(frozen=True, eq=False)
class MeshTask:
    """What a mesh method is fitted to.

    Parameters
    ----------
    target
        ``(V, 3)`` float32 vertices.
    mesh
        Faces of the target and of every source: vertices with the same index correspond.
    region
        ``(V,)`` bool: the vertices that receive the source's detail; the others do not move.
        Default: all.
    w
        Half width of the paper's Gaussian, which smooths the bases.
    """

    target: Float32
    mesh: GridMesh
    region: Bool | None = None
    w: int = 5


@dataclass(frozen=True, eq=False)
class Surfaces:
    """A source and a target as meshes with one vertex per pixel and the same faces.

    Parameters
    ----------
    source, target
        ``(V, 3)`` float32 vertices in pixels, for the same pixels in the same order.
    mesh
        Faces along the target's shorter diagonals. No face connects two parts of either surface,
        because their relative heights are not known.
    """

    source: Float32
    target: Float32
    mesh: GridMesh

    @classmethod
    def of(cls, source: processing.NormalMap, target: processing.NormalMap) -> Surfaces:
        """Integrate two maps of the same size and mask."""
        to_surface = processing.integrate(target, discontinuity=False)
        triangles = processing.height_mesh(to_surface)
        pixels = GridMesh(to_surface.mask, triangles.faces)
        ends = triangles.vertices
        starts, whole = _surface_on(source, pixels, ends)
        return cls(starts, ends, GridMesh(pixels.mask, triangles.faces[whole]))

    def read(self, vertices: Float32, elsewhere: processing.NormalMap) -> processing.NormalMap:
        """Return a map of the area-weighted normals of the vertices.

        Pixels without a face keep the normals of the map `elsewhere`.
        """
        return _read(vertices, self.mesh, elsewhere)

    def round_trip(self, normal_map: processing.NormalMap) -> processing.NormalMap:
        """Integrate a map and return the normals of its surface."""
        vertices, whole = _surface_on(normal_map, self.mesh, self.target)
        return _read(vertices, GridMesh(self.mesh.mask, self.mesh.faces[whole]), normal_map)


def _surface_on(
    normal_map: processing.NormalMap, mesh: GridMesh, instead: Float32
) -> tuple[Float32, Bool]:
    """Return a map's surface at a mesh's vertices, and which faces are within one part of it.

    Vertices that the surface does not cover are taken from `instead`.
    """
    surface = processing.integrate(normal_map, discontinuity=False)
    covered = surface.mask[mesh.mask]
    vertices = np.where(covered[:, None], surface.points()[mesh.mask], instead)
    parts = surface.parts[mesh.mask][mesh.faces]
    return vertices, (parts[:, 0] >= 0) & (parts == parts[:, :1]).all(axis=1)


def _read(
    vertices: Float32, mesh: GridMesh, elsewhere: processing.NormalMap
) -> processing.NormalMap:
    touched = np.zeros(len(vertices), np.bool_)
    touched[mesh.faces] = True
    normals = elsewhere.normals.copy()
    normals.reshape(-1, 3)[np.flatnonzero(mesh.mask)[touched]] = mesh.normals(vertices)[touched]
    return processing.NormalMap(normals, elsewhere.mask)
