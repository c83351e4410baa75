"""DSPL, a peer method for comparison: detail as displacement along the normals of a smooth base.

After Botsch et al., Polygon Mesh Processing (2010), chapter 9. Source and target share their
faces, so the correspondence, which a mesh method normally has to compute first, is given.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.paper.peers.protocol import Peer
from benchmarks.paper.peers.surfaces import MeshTask
from rig.arrays import Float32


class Displacement:
    """One target, prepared for the displacements of any source.

    In a region, the detail is blended in over the width of the base filter.
    """

    def __init__(self, task: MeshTask) -> None:
        self._target, self._mesh, self._w = task.target, task.mesh, task.w
        self._base = task.mesh.base(task.target, task.w)
        self._normals = task.mesh.normals(self._base)
        self._weight: Float32 | None = None
        if task.region is not None:
            # The weight outside the region stays 0: vertices there must not move.
            within = task.region[:, None]
            blurred = task.mesh.base(within.astype(np.float32), task.w)
            self._weight = np.where(within, blurred, np.float32(0))

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
    return Displacement(task).put


PEER = Peer("DSPL", "Botsch et al., Polygon Mesh Processing, 2010", _fit)
