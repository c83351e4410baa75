"""LAPL, a peer method for comparison: detail as rotated differential coordinates.

After Sorkine et al., Laplacian Surface Editing (SGP 2004), coating transfer: the difference between
the differential coordinates of the source and those of its smooth base is rotated from the source's
base to the target's base, and the surface with these coordinates is computed by least squares.
Source and target share their faces, so the correspondence, which a mesh method normally has to
compute first, is given.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from benchmarks.paper.peers.bilaplacian import Bilaplacian
from benchmarks.paper.peers.mesh import GridMesh
from benchmarks.paper.peers.protocol import Peer
from benchmarks.paper.peers.surfaces import MeshTask
from rig.arrays import Bool, Float32, Float64

# Takes a symmetric positive matrix; returns its solver for ``(n, 3)`` right-hand sides.
Factorise = Callable[[sparse.csc_array], Callable[[Float64], Float64]]

# Weight of the target's base positions relative to the differential coordinates, at w=5. Waves
# longer than about 22 vertices follow the base: they belong to the shape.
_ANCHOR = 0.02
# Negligible: in a region it only determines the vertices without faces.
_REGION_ANCHOR = 1e-4
# Relative residual: normals are within 0.01 degree of those of an exact solution.
_TOLERANCE = 1e-4


def superlu(matrix: sparse.csc_array) -> Callable[[Float64], Float64]:
    """Factorise with SuperLU: minimum degree of A' + A, without pivoting."""
    factors = linalg.splu(
        matrix,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return lambda b: np.asarray(factors.solve(b), np.float64)


class LaplacianEditing:
    """One target, prepared for the differential coordinates of any source.

    Parameters
    ----------
    task
        The target. Vertices outside its region fix the rim of the region.
    factorise
        Direct solver to use instead of multigrid. Multigrid is faster unless the factors are
        reused many times. A region is always solved directly, by default with `superlu`.
    """

    def __init__(self, task: MeshTask, factorise: Factorise | None = None) -> None:
        target, mesh, region, w = task.target, task.mesh, task.region, task.w
        self._mesh, self._w = mesh, w
        self._base = mesh.base(target, w)
        self._normals = mesh.normals(self._base)
        self._region = np.ones(len(target), np.bool_) if region is None else region
        # Outside the region, vertices and their coordinates stay those of the target.
        within = self._region[:, None]
        self._start = np.where(within, self._base, target)
        self._wanted = np.where(within, mesh.laplacian(self._base), mesh.laplacian(target))
        self._wanted -= mesh.laplacian(self._start)
        anchor = _ANCHOR * (5 / w) ** 2 if region is None else _REGION_ANCHOR
        self._solve: Callable[[Float64, Float64], Float64]
        if region is None and factorise is None:
            self._solve = _by_multigrid(mesh, anchor)
        else:
            self._solve = _directly(mesh, self._region, anchor, factorise or superlu)

    def put(self, source: Float32) -> Float32:
        """Return the vertices, ``(V, 3)``, of the target's base with the source's detail."""
        base = self._mesh.base(source, self._w)
        detail, normals = source - base, self._mesh.normals(base)
        coating = turned(self._mesh.laplacian(detail), normals, self._normals)
        wanted = self._wanted + np.where(self._region[:, None], coating, 0)
        guess = turned(detail.astype(np.float64), normals, self._normals)
        moved = self._start.copy()
        moved[self._region] += self._solve(
            self._mesh.laplacian(wanted)[self._region], guess[self._region]
        ).astype(np.float32)
        return moved


def _by_multigrid(mesh: GridMesh, anchor: float) -> Callable[[Float64, Float64], Float64]:
    inside = np.pad(mesh.inside, 1)
    matrix = Bilaplacian(*mesh.edges, inside, anchor)

    def solve(b: Float64, guess: Float64) -> Float64:
        solution = np.zeros_like(b)
        for axis in range(b.shape[1]):
            right_side, start = np.zeros((2, *inside.shape))
            right_side[inside], start[inside] = b[:, axis], guess[:, axis]
            solution[:, axis] = matrix.solve(right_side, start, _TOLERANCE)[inside]
        return solution

    return solve


def _directly(
    mesh: GridMesh, region: Bool, anchor: float, factorise: Factorise
) -> Callable[[Float64, Float64], Float64]:
    # Vertices outside the region are fixed: only the columns of the region are unknowns.
    columns = _matrix(mesh)[:, np.flatnonzero(region)]
    normal = columns.T @ columns + anchor**2 * sparse.eye_array(columns.shape[1])
    solve = factorise(sparse.csc_array(normal))
    return lambda b, _: solve(b)


def _matrix(mesh: GridMesh) -> sparse.csc_array:
    """Return the ``(V, V)`` matrix of `GridMesh.laplacian`."""
    right, down = mesh.edges
    number = np.full(right.shape, -1, np.int32)
    inside = np.pad(mesh.inside, 1)
    number[inside] = np.arange(np.count_nonzero(inside), dtype=np.int32)
    begin = np.concatenate([number[right > 0], number[down > 0]])
    end = np.concatenate(
        [number[np.roll(right, 1, axis=1) > 0], number[np.roll(down, 1, axis=0) > 0]]
    )
    size = np.count_nonzero(inside)
    weights = sparse.coo_array((np.full(len(begin), 0.25), (begin, end)), shape=(size, size))
    both = sparse.csc_array(weights + weights.T)
    return sparse.csc_array(sparse.diags_array(both.sum(axis=0)) - both)


@numba.njit(cache=True)
def turned(vectors: Float64, starts: Float32, ends: Float32) -> Float64:
    """Apply to each vector the shortest rotation between two unit vectors that are not opposite."""
    out = np.zeros_like(vectors)
    for v in range(len(vectors)):
        sx, sy, sz = np.float64(starts[v, 0]), np.float64(starts[v, 1]), np.float64(starts[v, 2])
        ex, ey, ez = np.float64(ends[v, 0]), np.float64(ends[v, 1]), np.float64(ends[v, 2])
        x, y, z = vectors[v, 0], vectors[v, 1], vectors[v, 2]
        cosine = sx * ex + sy * ey + sz * ez
        ax, ay, az = sy * ez - sz * ey, sz * ex - sx * ez, sx * ey - sy * ex
        along = (ax * x + ay * y + az * z) / max(1 + cosine, 1e-9)
        out[v, 0] = cosine * x + ay * z - az * y + ax * along
        out[v, 1] = cosine * y + az * x - ax * z + ay * along
        out[v, 2] = cosine * z + ax * y - ay * x + az * along
    return out


def fit(task: MeshTask, factorise: Factorise | None = None) -> Callable[[Float32], Float32]:
    """Prepare a target; return the transfer of a source's vertices."""
    return LaplacianEditing(task, factorise).put


PEER = Peer("LAPL", "Sorkine et al., SGP 2004", fit)
