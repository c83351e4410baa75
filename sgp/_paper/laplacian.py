"""LAPL, a peer to compare with: detail as rotated differential coordinates.

After Sorkine et al., Laplacian Surface Editing (SGP 2004), coating transfer: what the differential
coordinates of the source have beyond those of its smooth base is turned from the source's base to
the target's, and the surface with these coordinates is found by least squares. Source and target
share their faces: the correspondence that a mesh method must otherwise first find is given to it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import linalg

from sgp._paper.mesh import Faces, Vectors, base, umbrella, vertex_normals

# Pull of every vertex toward the target's base, beside the differential coordinates, at w=5. Waves
# of more than about 25 vertices follow it: these belong to the shape.
_ANCHOR = 0.02


def transfer_by_laplacian(
    source: Vectors,
    target: Vectors,
    faces: Faces,
    region: npt.NDArray[np.bool_] | None = None,
    w: int = 5,
) -> Vectors:
    """Put the differential coordinates of one surface's detail onto another's smooth base.

    Parameters
    ----------
    source, target
        ``(V, 3)`` vertices, the same vertex of both in correspondence.
    faces
        ``(F, 3)`` of both.
    region
        ``(V,)`` bool: the vertices that receive the source's detail; the others keep their places
        and hold the rim of the region. Default: all.
    w
        Of the paper's Gaussian that the base is as smooth as.

    Returns
    -------
    Vectors
        ``(V, 3)`` vertices.
    """
    mean = umbrella(faces, len(target))
    laplacian = sparse.csr_array(sparse.eye_array(len(target)) - mean)
    source_base, target_base = base(mean, source, w), base(mean, target, w)
    coating = _turned(
        laplacian @ (source - source_base),
        vertex_normals(source_base, faces),
        vertex_normals(target_base, faces),
    )
    if region is None:
        wanted, start, columns = coating, target_base, laplacian
        anchor = _ANCHOR * (5 / w) ** 2
    else:
        # Fixed vertices are known: only the columns of the free ones are unknowns, and the rim
        # holds them. Outside the region the coordinates stay the target's own.
        start = np.where(region[:, None], target_base, target)
        meant = np.where(region[:, None], laplacian @ target_base + coating, laplacian @ target)
        wanted = meant - laplacian @ start
        columns = sparse.csr_array(laplacian[:, np.flatnonzero(region)])
        # Next to nothing: it only decides about vertices that no face touches.
        anchor = 1e-4
    normal = columns.T @ columns + anchor**2 * sparse.eye_array(columns.shape[1])
    solver = linalg.splu(
        sparse.csc_array(normal),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    step = solver.solve(columns.T @ wanted)
    if region is None:
        return np.asarray(start + step, np.float64)
    moved = start.copy()
    moved[region] += step
    return moved


def _turned(vectors: Vectors, starts: Vectors, ends: Vectors) -> Vectors:
    """Apply to each vector the shortest rotation between two unit vectors that are not opposite."""
    axis = np.cross(starts, ends)
    cosine = np.einsum("ij,ij->i", starts, ends)[:, None]
    along = np.einsum("ij,ij->i", axis, vectors)[:, None]
    turned: Vectors = (
        cosine * vectors + np.cross(axis, vectors) + axis * along / np.maximum(1 + cosine, 1e-9)
    )
    return turned
