"""Whether a mesh is a surface everywhere."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def crowded_edges(faces: npt.NDArray[np.int32]) -> int:
    """Return how many edges join more than two of ``(F, 3)`` faces.

    Faces that name a vertex twice do not count.
    """
    a, b, c = faces.T.astype(np.int64)
    whole = (a != b) & (b != c) & (c != a)
    corners = int(faces.max()) + 1
    ends = ((a[whole], b[whole]), (b[whole], c[whole]), (c[whole], a[whole]))
    edges = np.concatenate([np.minimum(p, q) * corners + np.maximum(p, q) for p, q in ends])
    edges.sort()
    third = edges[2:] == edges[:-2]
    # An edge of n faces is third n - 2 times in a row, and counts once.
    return int(np.count_nonzero(third[1:] & ~third[:-1])) + int(third[:1].any())
