"""Comparison of two normal maps: angular error and structural similarity."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numba
import numpy as np
import numpy.typing as npt

from acquisition import DataError, angle_deg
from processing.maps.normal_map import NormalMap, check_mask, check_normal_map
from processing.maps.ssim_kernel import similarity_rows
from rig import in_threads, short_repr
from rig.arrays import Bool, Float32, Float64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

__all__ = ["AngularError", "angle_deg", "angular_error", "ssim"]

Protocol = Literal["masked", "paper"]

# Error of a pixel without a normal, as in the published benchmarks.
_MISSING_DEG = 90.0


@dataclass(frozen=True, eq=False)
class AngularError:
    """The angular error of a normal map with respect to the ground truth.

    Parameters
    ----------
    mae_deg, median_deg
        Mean and median over all pixels of the mask; a pixel without a normal counts as 90 degrees.
    coverage
        Fraction of the mask that has a normal, 0..1.
    map_deg
        ``(H, W)`` float32 error per pixel, NaN outside the mask.
    """

    mae_deg: float
    median_deg: float
    coverage: float
    map_deg: Float32

    __repr__ = short_repr


def angular_error(
    estimate: NormalMap, truth: NormalMap | npt.ArrayLike, mask: Bool | None = None
) -> AngularError:
    """Measure the angular error of a normal map.

    Parameters
    ----------
    estimate
        The map to evaluate.
    truth
        Another map, or ``(H, W, 3)`` vectors, of the same size.
    mask
        ``(H, W)`` bool, the pixels to evaluate. Default: all pixels with a true normal.

    Returns
    -------
    AngularError
        The error over the mask. Pixels whose true normal is unknown are excluded.

    Raises
    ------
    DataError
        If the sizes differ or no pixel is left to compare.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, angular_error
    >>> flat = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (4, 5, 1)))
    >>> tilted = NormalMap.from_vectors(np.tile([0.0, 1.0, 1.0], (4, 5, 1)))
    >>> round(angular_error(tilted, flat).mae_deg, 3)
    45.0
    """
    check_normal_map("estimate", estimate)
    truth_map = truth if isinstance(truth, NormalMap) else NormalMap.from_vectors(truth)
    counted = truth_map.mask & check_mask("mask", mask, truth_map.size)
    _check_sizes(estimate, truth_map)
    if not counted.any():
        raise DataError("no pixel of the mask has a true normal: nothing to compare")
    both = counted & estimate.mask
    map_deg = angle_map_deg(estimate.normals, truth_map.normals, both)
    map_deg[counted & ~both] = _MISSING_DEG
    errors = map_deg[counted].astype(np.float64)
    return AngularError(
        mae_deg=float(errors.mean()),
        median_deg=float(np.median(errors)),
        coverage=float(np.count_nonzero(both) / np.count_nonzero(counted)),
        map_deg=map_deg,
    )


def angle_map_deg(a: Float32, b: npt.ArrayLike, mask: Bool) -> Float32:
    """Return the angle between two ``(H, W, 3)`` maps, or a map and a vector; NaN outside a mask.

    It is that of `angle_deg`, of vectors in float32.
    """
    first, second = (np.ascontiguousarray(vectors, np.float32) for vectors in (a, b))
    angles = np.full(mask.shape, np.nan, np.float32)
    second = second if second.ndim == 3 else second[None, None]
    in_threads(_angles, len(mask), first, second, mask, angles)
    return angles


@numba.njit(**PART)
def _angles_of_row(a: Float32, b: Float32, mask: Bool, out: Float32) -> None:
    for c in range(mask.size):
        if not mask[c]:
            continue
        d = c if len(b) > 1 else 0
        ax, ay, az = np.float64(a[c, 0]), np.float64(a[c, 1]), np.float64(a[c, 2])
        bx, by, bz = np.float64(b[d, 0]), np.float64(b[d, 1]), np.float64(b[d, 2])
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        sine = math.sqrt(x * x + y * y + z * z)
        out[c] = math.degrees(math.atan2(sine, ax * bx + ay * by + az * bz))


@numba.njit(nogil=True, cache=True)
def _angles(first: int, last: int, a: Float32, b: Float32, mask: Bool, out: Float32) -> None:
    """Write the angles of the pixels of a mask; ``b`` has the size of ``a``, or one pixel."""
    for r in range(first, last):
        if len(b) > 1:
            _angles_of_row(a[r], b[r], mask[r], out[r])
        else:
            _angles_of_row(a[r], b[0], mask[r], out[r])


def ssim(
    a: NormalMap,
    b: NormalMap,
    mask: Bool | None = None,
    *,
    protocol: Protocol = "masked",
) -> float:
    """Return the structural similarity of two normal maps, averaged over the three channels.

    Normals are mapped to ``n / 2 + 0.5``; the window is a Gaussian of 11 x 11 pixels with a sigma
    of 1.5 (Wang et al., 2004).

    Parameters
    ----------
    a, b
        Maps of the same size.
    mask
        ``(H, W)`` bool, the pixels to compare. Default: all pixels where at least one map has a
        normal. If only one map has a normal, the other is a zero vector there, which lowers the
        similarity.
    protocol
        ``masked``: window statistics over the mask only, averaged over the mask, with the usual
        constants 0.01^2 and 0.03^2. ``paper``: the background of both maps is z, the average is
        over the complete frame regardless of the mask, and the constants are 0.01 and 0.03 as
        printed in the paper; both raise the value, so compare it only with the paper's values.

    Returns
    -------
    float
        At most 1; 1 for equal maps.

    Raises
    ------
    DataError
        If the sizes differ, the mask is empty, or the protocol is not known.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, ssim
    >>> y, x = np.mgrid[1:-1:24j, -1:1:24j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> hill = NormalMap.from_vectors(np.dstack([-x, -y, 0 * x + 2]))
    >>> round(ssim(bowl, bowl), 6), ssim(bowl, hill) < 0.5
    (1.0, True)
    """
    check_normal_map("a", a)
    check_normal_map("b", b)
    if protocol not in get_args(Protocol):
        raise DataError(f"{protocol!r} is not a protocol: use {' or '.join(get_args(Protocol))}")
    _check_sizes(a, b)
    counted = a.mask | b.mask if mask is None else check_mask("mask", mask, a.size)
    if not counted.any():
        raise DataError("the mask is empty: nothing to compare")
    sums = similarity_of_rows(a.normals, b.normals, (a.mask, b.mask), counted, protocol)
    return mean_similarity(sums, counted, protocol)


def similarity_of_rows(
    a: Float32, b: Float32, masks: tuple[Bool, Bool], counted: Bool, protocol: Protocol
) -> Float64:
    """Return the sums over rows of which `mean_similarity` makes the similarity of `ssim`.

    Parameters
    ----------
    a, b
        ``(n, W, 3)`` rows of two maps. The first and last 5 of them are only those of the complete
        maps if these begin and end there.
    masks
        Where the maps have a normal.
    counted
        The pixels to compare.
    protocol
        As for `ssim`.
    """
    if protocol == "paper":
        return similarity_rows(a, b, np.ones(counted.shape, np.bool_), 0.01, 0.03, masks)
    return similarity_rows(a, b, counted, 0.01**2, 0.03**2)


def mean_similarity(sums: Float64, counted: Bool, protocol: Protocol) -> float:
    """Return the similarity of two maps from the sums of all of their rows."""
    if protocol == "paper":
        return float(np.mean(sums) / counted.shape[1])
    return float(sums.sum() / np.count_nonzero(counted))


def _check_sizes(a: NormalMap, b: NormalMap) -> None:
    if a.size != b.size:
        raise DataError(
            f"cannot compare normal maps of {_text(a.size)} and {_text(b.size)} pixels: they must "
            "have the same size"
        )


def _text(size: tuple[int, int]) -> str:
    return f"{size[1]} x {size[0]}"
