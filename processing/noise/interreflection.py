"""Errors of normals by light from other parts of the object."""

from __future__ import annotations

import numpy as np

from acquisition import MapRows
from processing.noise.around import mean_around
from processing.noise.sample_kind import SampleKind
from rig.arrays import Bool, Float32

# Angle of a normal, rad, by the blocked share of its sky: in a hollow sphere that is cut open, one
# reflection by an albedo of 0.5 turns normals by 0.17 to 0.24 of this share (root mean square, caps
# of 30 to 90 degrees; the light is the same at all points of a sphere).
_TURN_RAD = 0.2
# Pixels across over which shares are averaged.
_ACROSS = 5


def reflected_variance(samples: MapRows, valid: Bool, rows: slice) -> Float32:
    """Return the variance of normals by light that the object reflects onto itself, in rad^2.

    Residuals hardly show this light, because much of it is matte. What blocks lights also reflects
    some of their light: the share of samples in cast shadow is that of a pixel's sky which the
    object covers.

    Parameters
    ----------
    samples
        ``(H, 6, W)`` number of samples of each `SampleKind`.
    valid
        ``(H, W)`` bool, the pixels with a normal.
    rows
        Rows to compute, with start and stop.
    """
    around = _ACROSS // 2
    part = slice(max(rows.start - around, 0), min(rows.stop + around, len(valid)))
    counts = samples[part]
    blocked = counts[:, SampleKind.CAST].astype(np.float32)
    facing = blocked + counts[:, SampleKind.LIT] + counts[:, SampleKind.OUTLIER]
    share = np.where(valid[part], blocked / np.maximum(facing, 1), 0).astype(np.float32)
    mean = mean_around(share, valid[part], _ACROSS)
    inner = slice(rows.start - part.start, rows.stop - part.start)
    return np.asarray(np.square(_TURN_RAD * mean[inner]), np.float32)
