"""DSPL, a peer method for comparison: detail as displacement along the normals of a smooth base.

After Botsch et al., Polygon Mesh Processing (2010), chapter 9. Source and target share their
faces, so the correspondence, which a mesh method normally has to compute first, is given.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.paper.peers.mesh import GridMesh
from benchmarks.paper.peers.protocol import Peer
from benchmarks.paper.peers.surfaces import MeshTask
from rig.arrays import Bool, Float32


class Displacement:
    """One target, prepared for the displacements of any source.

    Parameters
    ----------
    target
        ``(V, 3)`` float32 vertices.
    mesh
        Faces of the target and of every source: vertices with the same index correspond.
    region
        ``(V,)`` bool: the vertices that receive the source's detail, blended in over the width of
        the base filter; the other vertices do not move. Default: all.
    w
        Half width of the paper's Gaussian, which smooths the bases.
    """

    def __init__(
        self, target: Float32, mesh: GridMesh, region: Bool | None = None, w: int = 5
    ) -> None:
        self._target, self._mesh, self._w = target, mesh, w
        self._base = mesh.base(target, w)
        self._normals = mesh.normals(self._base)
        self._weight: Float32 | None = None
        if region is not None:
            # The weight outside the region stays 0: vertices there must not move.
            blurred = mesh.base(region[:, None].astype(np.float32), w)
            self._weight = np.where(region[:, None], blurred, np.float32(0))

    def put(self, source: Float32) -> Float32:
        """Return the target's base, ``(V, 3)``, with the displacements of the source."""
        base = self._mesh.base(source, self._w)
        height = np.einsum("ij,ij->i", source - base, self._mesh.normals(base))
        moved: Float32 = self._base + height[:, None] * self._normals
        if self._weight is None:
            return moved
        blended: Float32 = self._weight * moved + (1 - self._weight) * self._target
        return blended


def _fit(task: MeshTask) -> Callable[[Float32], Float32]:
    return Displacement(task.target, task.mesh, task.region, task.w).put


PEER = Peer("DSPL", "Botsch et al., Polygon Mesh Processing, 2010", _fit)
