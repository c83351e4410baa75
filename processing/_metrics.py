"""Comparison of two normal maps: angular error and structural similarity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import DataError, angle_deg
from processing._normal_map import NormalMap, check_normal_map
from rig import short_repr

__all__ = ["AngularError", "angle_deg", "angular_error", "ssim"]

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

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
    map_deg: Float

    __repr__ = short_repr


def angular_error(
    estimate: NormalMap, truth: NormalMap | npt.ArrayLike, mask: Mask | None = None
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
    """
    check_normal_map("estimate", estimate)
    truth_map = truth if isinstance(truth, NormalMap) else NormalMap.from_vectors(truth)
    counted = (
        truth_map.mask if mask is None else truth_map.mask & _checked_mask(mask, truth_map.size)
    )
    _check_sizes(estimate, truth_map)
    if not counted.any():
        raise DataError("no pixel of the mask has a true normal: nothing to compare")
    both = counted & estimate.mask
    map_deg = np.full(truth_map.size, np.nan, np.float32)
    map_deg[counted] = _MISSING_DEG
    map_deg[both] = angle_deg(estimate.normals[both], truth_map.normals[both])
    errors = map_deg[counted].astype(np.float64)
    return AngularError(
        mae_deg=float(errors.mean()),
        median_deg=float(np.median(errors)),
        coverage=float(np.count_nonzero(both) / np.count_nonzero(counted)),
        map_deg=map_deg,
    )


def ssim(
    a: NormalMap,
    b: NormalMap,
    mask: Mask | None = None,
    *,
    protocol: Literal["masked", "paper"] = "masked",
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
        If the sizes differ or the mask is empty.
    """
    check_normal_map("a", a)
    check_normal_map("b", b)
    _check_sizes(a, b)
    counted = a.mask | b.mask if mask is None else _checked_mask(mask, a.size)
    if not counted.any():
        raise DataError("the mask is empty: nothing to compare")
    if protocol == "paper":
        weight = np.ones(a.size)
        first, second = (np.where(m.mask[..., None], m.normals, (0.0, 0.0, 1.0)) for m in (a, b))
        similarity = _ssim_map(first, second, weight, 0.01, 0.03)
        return float(similarity.mean())
    weight = counted.astype(np.float64)
    similarity = _ssim_map(a.normals, b.normals, weight, 0.01**2, 0.03**2)
    return float(similarity[counted].mean())


def _ssim_map(
    a: npt.NDArray[np.floating], b: npt.NDArray[np.floating], weight: Double, c1: float, c2: float
) -> Double:
    """Return the ``(H, W, 3)`` similarities, with statistics over the pixels of weight 1."""

    def blur(image: Double) -> Double:
        blurred = cv2.GaussianBlur(image, (11, 11), 1.5, borderType=cv2.BORDER_REFLECT_101)
        return np.asarray(blurred, np.float64)

    w = weight[..., None]
    total = blur(weight)[..., None]
    total = np.where(total > 0, total, 1.0)
    x, y = ((0.5 + 0.5 * n.astype(np.float64)) * w for n in (a, b))
    mean_x, mean_y = blur(x) / total, blur(y) / total
    variance_x = blur(x * x) / total - mean_x**2
    variance_y = blur(y * y) / total - mean_y**2
    covariance = blur(x * y) / total - mean_x * mean_y
    similarity: Double = (
        (2 * mean_x * mean_y + c1)
        * (2 * covariance + c2)
        / ((mean_x**2 + mean_y**2 + c1) * (variance_x + variance_y + c2))
    )
    return similarity


def _check_sizes(a: NormalMap, b: NormalMap) -> None:
    if a.size != b.size:
        raise DataError(
            f"cannot compare normal maps of {_text(a.size)} and {_text(b.size)} pixels: they must "
            "have the same size"
        )


def _checked_mask(mask: Mask, size: tuple[int, int]) -> Mask:
    if mask.dtype != np.bool_ or mask.shape != size:
        raise DataError(
            f"a mask of {mask.dtype} and shape {mask.shape} does not fit maps of {_text(size)}"
        )
    return mask


def _text(size: tuple[int, int]) -> str:
    return f"{size[1]} x {size[0]}"
