"""DSPL, a peer to compare with: detail as displacement along the normals of a smooth base.

After Botsch et al., Polygon Mesh Processing (2010), chapter 9. Source and target share their
faces: the correspondence that a mesh method must otherwise find first is given to it.
"""

from __future__ import annotations

import numpy as np

from sgp._paper.mesh import Float, GridMesh, Mask


class Displacement:
    """One target, ready for the displacements of any source.

    Parameters
    ----------
    target
        ``(V, 3)`` float32 vertices.
    mesh
        Its faces, and those of every source: vertices of one number correspond.
    region
        ``(V,)`` bool: the vertices that receive the source's detail, blended in over the width of
        the base's filter; the others keep their places. Default: all.
    w
        Of the paper's Gaussian that smooths the bases.
    """

    def __init__(
        self, target: Float, mesh: GridMesh, region: Mask | None = None, w: int = 5
    ) -> None:
        self._target, self._mesh, self._w = target, mesh, w
        self._base = mesh.base(target, w)
        self._normals = mesh.normals(self._base)
        self._weight: Float | None = None
        if region is not None:
            # Outside the weight is 0 and stays so: nothing there may move.
            blurred = mesh.base(region[:, None].astype(np.float32), w)
            self._weight = np.where(region[:, None], blurred, np.float32(0))

    def put(self, source: Float) -> Float:
        """Return the target's base, ``(V, 3)``, displaced as the source is from its own base."""
        base = self._mesh.base(source, self._w)
        height = np.einsum("ij,ij->i", source - base, self._mesh.normals(base))
        moved: Float = self._base + height[:, None] * self._normals
        if self._weight is None:
            return moved
        blended: Float = self._weight * moved + (1 - self._weight) * self._target
        return blended
