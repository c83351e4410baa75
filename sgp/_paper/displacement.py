"""DSPL, a peer to compare with: detail as displacement along the normals of a smooth base.

After Botsch et al., Polygon Mesh Processing (2010), chapter 9. Source and target share their
faces: the correspondence that a mesh method must otherwise first find is given to it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sgp._paper.mesh import Faces, Vectors, base, umbrella, vertex_normals


def transfer_by_displacement(
    source: Vectors,
    target: Vectors,
    faces: Faces,
    region: npt.NDArray[np.bool_] | None = None,
    w: int = 5,
) -> Vectors:
    """Put the displacements of one surface onto the smooth base of another.

    Parameters
    ----------
    source, target
        ``(V, 3)`` vertices, the same vertex of both in correspondence.
    faces
        ``(F, 3)`` of both.
    region
        ``(V,)`` bool: the vertices that receive the source's detail, blended in over the width of
        the base's filter; the others keep their places. Default: all.
    w
        Of the paper's Gaussian that the base is as smooth as.

    Returns
    -------
    Vectors
        ``(V, 3)`` vertices.
    """
    mean = umbrella(faces, len(target))
    source_base, target_base = base(mean, source, w), base(mean, target, w)
    height = np.einsum("ij,ij->i", source - source_base, vertex_normals(source_base, faces))
    moved: Vectors = target_base + height[:, None] * vertex_normals(target_base, faces)
    if region is None:
        return moved
    # Outside the weight is 0 and stays so: nothing there may move.
    weight = np.where(region, base(mean, region[:, None].astype(np.float64), w)[:, 0], 0.0)[:, None]
    blended: Vectors = weight * moved + (1 - weight) * target
    return blended
