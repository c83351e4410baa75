"""The kernels that join vertices and examine edges, against slow definitions."""

from collections import Counter

import numpy as np
import pytest

from processing.projection.mesh_kernels import edge_faults, joined_vertices


@pytest.mark.parametrize("seed", range(6))
def test_vertices_are_numbered_by_their_first_appearance(seed):
    rng = np.random.default_rng(seed)
    vertices = rng.integers(-2, 3, (200, 3)) * np.array([1.0, -0.0, 1e-300])
    used = rng.random(200) < 0.8
    numbers = {}
    expected = [numbers.setdefault(tuple(v), len(numbers)) for v in vertices[used]]
    kept, number = joined_vertices(vertices, used)
    assert number[used].tolist() == expected
    assert (vertices[kept] == np.array(list(numbers))).all()
    assert (np.diff(kept) > 0).all()


def faults(faces):
    """Count edges with more than two faces, and look for half-edges that occur twice."""
    halves = Counter(
        (int(p), int(q))
        for face in faces
        if len(set(face.tolist())) == 3
        for p, q in zip(face, np.roll(face, -1), strict=True)
    )
    edges = Counter()
    for (p, q), count in halves.items():
        edges[min(p, q), max(p, q)] += count
    return sum(count > 2 for count in edges.values()), any(n > 1 for n in halves.values())


@pytest.mark.parametrize("seed", range(12))
def test_edge_faults(seed):
    rng = np.random.default_rng(seed)
    faces = rng.integers(0, (5, 12, 40, 300)[seed % 4], (1 + 5 * seed, 3)).astype(np.int32)
    assert edge_faults(faces) == faults(faces)


def test_a_fan_with_many_faces_at_a_vertex():
    rim = np.arange(1, 200, dtype=np.int32)
    fan = np.stack([np.zeros_like(rim), rim, rim + 1], axis=1)
    assert edge_faults(fan) == (0, False)
    both = np.concatenate([fan, fan[50:51]])
    assert edge_faults(both) == faults(both)
