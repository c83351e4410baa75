"""Seamless insertion of one detail into another by a membrane on the sphere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numba
import numpy as np

from processing.maps.mask import bounding_box
from processing.maps.metrics import angle_deg
from processing.maps.normal_map import NormalMap
from rig.arrays import Bool, Float32, Float64, Int32

_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
# Slices that enumerate each pair of neighbours once: (left, right) and (upper, lower).
_NEIGHBOURS = (
    ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
    ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
)


def seam_of(region: Bool, target: Bool) -> Bool:
    """Return the pixels of a region that have a neighbour in the target but not in the region."""
    around = cv2.dilate((target & ~region).astype(np.uint8), _CROSS)
    return region & (around > 0)


def blend_detail(inner: NormalMap, outer: NormalMap, region: Bool, reach_px: float) -> Float32:
    """Insert one detail into another without a step at the seam.

    This is Poisson image editing (Perez et al., 2003) on the sphere. The logarithm map takes both
    details to the tangent plane at z, a screened membrane extends the difference along the seam
    into the region, and the exponential map takes the result back to unit vectors. A detail
    contains no shape, so the difference fluctuates about 0 along the seam and decays inside.

    Parameters
    ----------
    inner, outer
        Detail maps of the same size, both known over the region.
    region
        ``(H, W)`` bool, the pixels that receive `inner`.
    reach_px
        Distance from the seam at which the difference has fallen to 1/e.

    Returns
    -------
    Float
        ``(H, W, 3)`` float32: `inner` with the membrane added inside the region, `outer` around it.
        On the pixels of the seam it is exactly `outer`.
    """
    return blend_from(inner.normals, outer.normals, seam_of(region, outer.mask), region, reach_px)


def blend_from(
    inner: Float32, outer: Float32, seam: Bool, region: Bool, reach_px: float
) -> Float32:
    """Insert vectors into a region as `blend_detail` does, with a given seam.

    Parameters
    ----------
    inner, outer
        ``(H, W, 3)`` float32: unit vectors of the region, and those around it and on the seam.
    seam
        ``(H, W)`` bool, the pixels of the region on which the result is `outer`.
    region, reach_px
        As for `blend_detail`.
    """
    unrolled = _logarithm(inner)
    step = np.where(seam[..., None], _logarithm(outer) - unrolled, 0)
    bent = _exponential(unrolled + _membrane(step, seam, region, reach_px))
    return np.where((region & ~seam)[..., None], bent, outer)


@dataclass(frozen=True)
class SeamSteps:
    """The mean angle between neighbouring normals at a seam and inside an inserted part.

    Parameters
    ----------
    seam_deg
        Step across the seam: the larger of the mean steps into and out of the outermost pixels of
        the part. For tiles and patches: the mean step of the detail across their borders.
    interior_deg
        Step between neighbours inside the part, without its outermost pixels; inside tiles and
        patches.
    """

    seam_deg: float
    interior_deg: float

    @property
    def ratio(self) -> float:
        """Step at the seam divided by the interior step, NaN if that is 0.

        No seam is visible up to a ratio of about 1.
        """
        return self.seam_deg / self.interior_deg if self.interior_deg else math.nan


def seam_steps(result: NormalMap, region: Bool) -> SeamSteps:
    """Measure the mean angle between neighbouring normals across a region's seam and inside it.

    A step is NaN if the region has no seam, or no pixel inside the seam.
    """
    seam = seam_of(region, result.mask)
    inside = region & ~seam
    pairs = {"out": (seam, result.mask & ~region), "in": (seam, inside), "inner": (inside, inside)}
    steps: dict[str, list[Float64]] = {name: [] for name in pairs}
    for first, second in _NEIGHBOURS:
        turn = angle_deg(result.normals[first], result.normals[second])
        for name, (a, b) in pairs.items():
            steps[name].append(turn[(a[first] & b[second]) | (b[first] & a[second])])
    outwards, inwards, inner = (_mean(np.concatenate(steps[name])) for name in pairs)
    return SeamSteps(float(np.fmax(outwards, inwards)), inner)


def border_sums(normals: Float32, known: Bool, labels: Int32) -> Float64:
    """Return the sums that `steps_of_sums` needs for rows of a placed detail.

    Parameters
    ----------
    normals, known
        ``(n, W, 3)`` and ``(n, W)``, the detail.
    labels
        ``(n, W)`` number of the copy at each pixel; pixels below 0 are not measured.

    Returns
    -------
    Double
        ``(n, 4)``: sum in degrees and number of the steps across borders, and inside copies, to the
        right and downwards. Those of the last row are only to the right.
    """
    sums = np.zeros((len(known), 4))
    measured = known & (labels >= 0)
    for first, second in _NEIGHBOURS:
        turn = angle_deg(normals[first], normals[second])
        both, same = measured[first] & measured[second], labels[first] == labels[second]
        for k, counted in enumerate((both & ~same, both & same)):
            sums[: len(turn), 2 * k] += np.where(counted, turn, 0).sum(axis=1)
            sums[: len(turn), 2 * k + 1] += np.count_nonzero(counted, axis=1)
    return sums


def steps_of_sums(sums: Float64) -> SeamSteps:
    """Return the mean steps of the rows of `border_sums`; NaN without any."""
    across, crossed, inside, same = (float(np.ascontiguousarray(s).sum()) for s in sums.T)
    return SeamSteps(across / crossed if crossed else math.nan, inside / same if same else math.nan)


def _mean(values: Float64) -> float:
    return float(values.mean()) if values.size else float("nan")


def _logarithm(vectors: Float32) -> Float64:
    """Return ``(H, W, 2)`` tangent vectors at z: their length is the angle to z in radians."""
    x, y, z = (vectors[..., k].astype(np.float64) for k in range(3))
    sine = np.hypot(x, y)
    # The limit at z is 1. At (0, 0, -1) every direction is valid; x is chosen.
    factor = np.divide(np.arctan2(sine, z), sine, out=np.ones_like(sine), where=sine > 0)
    return np.stack([np.where((sine == 0) & (z < 0), np.pi, x * factor), y * factor], axis=2)


def _exponential(tangents: Float64) -> Float32:
    angle = np.hypot(tangents[..., 0], tangents[..., 1])
    factor = np.sinc(angle / np.pi)
    out = np.dstack([tangents * factor[..., None], np.cos(angle)])
    return out.astype(np.float32)


def _membrane(step: Float64, seam: Bool, region: Bool, reach_px: float) -> Float64:
    """Solve (Laplacian - 1 / reach^2) u = 0 inside a region with u = step on its seam.

    The boundary of the region outside the seam is free. One sweep of red-black over-relaxation with
    the optimal factor reduces an error at least by the factor exp(-1.4 / reach), so the required
    number of sweeps is known in advance.
    """
    box = bounding_box(region)
    u = np.pad(step[box], ((1, 1), (1, 1), (0, 0)))
    linked, free = np.pad(region[box], 1), np.pad((region & ~seam)[box], 1)
    screen = 1 / reach_px**2
    factor = 2 / (1 + math.sqrt(1 - (4 / (4 + screen)) ** 2))
    for _ in range(math.ceil(10 * reach_px)):
        for colour in (0, 1):
            _relax(u, linked, free, screen, factor, colour)
    out = np.zeros_like(step)
    out[box] = u[1:-1, 1:-1]
    return out


@numba.njit(parallel=True, cache=True)
def _relax(u: Float64, linked: Bool, free: Bool, screen: float, factor: float, colour: int) -> None:
    rows, columns = free.shape
    for r in numba.prange(1, rows - 1):
        for c in range(1 + (r + colour) % 2, columns - 1, 2):
            if not free[r, c]:
                continue
            weight, x, y = screen, 0.0, 0.0
            for q, d in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
                if linked[q, d]:
                    weight += 1.0
                    x += u[q, d, 0]
                    y += u[q, d, 1]
            u[r, c, 0] += factor * (x / weight - u[r, c, 0])
            u[r, c, 1] += factor * (y / weight - u[r, c, 1])
