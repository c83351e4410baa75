"""Measures of the properties that the paper claims for detail.

Detail is separable, transferable and idempotent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition import DataError
from processing.detail.detail_transfer import TransferResult, transfer
from processing.detail.placement import largest_rectangle
from processing.detail.separation import Separation, combine, separate
from processing.detail.shape_filter import ShapeFilter
from processing.maps.metrics import angular_error, ssim
from processing.maps.normal_map import NormalMap
from rig import short_repr


@dataclass(frozen=True)
class DetailComparison:
    """How well two details agree.

    Parameters
    ----------
    mae_deg
        Mean angle.
    ssim
        Structural similarity over the mask.
    ssim_paper
        Structural similarity in the paper's protocol; see `processing.ssim`.
    """

    mae_deg: float
    ssim: float
    ssim_paper: float

    __repr__ = short_repr


def compare_details(detail: NormalMap, reference: NormalMap) -> DetailComparison:
    """Compare two details of the same size.

    Raises
    ------
    DataError
        If the sizes differ.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.detail import compare_details
    >>> x = np.tile(np.arange(24.0), (24, 1))
    >>> ripples = NormalMap.from_vectors(np.dstack([0.2 * np.sin(x), 0 * x, 0 * x + 1]))
    >>> comparison = compare_details(ripples, ripples)
    >>> comparison.mae_deg, round(comparison.ssim, 6)
    (0.0, 1.0)
    """
    return DetailComparison(
        angular_error(detail, reference).mae_deg,
        ssim(detail, reference),
        ssim(detail, reference, protocol="paper"),
    )


def idempotence(parts: Separation, highest: int = 4) -> dict[int, DetailComparison]:
    """Separate a detail repeatedly, and compare the detail of each order with the first.

    Parameters
    ----------
    parts
        A separation; its detail is the detail of order 1.
    highest
        The highest order, 2 or more.

    Returns
    -------
    dict[int, DetailComparison]
        Comparison with the first detail, by order, starting at 2.

    Raises
    ------
    DataError
        If `highest` is below 2.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, separate
    >>> from processing.detail import idempotence
    >>> x = np.tile(np.arange(32.0), (32, 1))
    >>> parts = separate(NormalMap.from_vectors(np.dstack([np.sin(x), 0 * x, 0 * x + 2])))
    >>> sorted(idempotence(parts))
    [2, 3, 4]
    """
    if highest < 2:
        raise DataError(f"the detail of a detail has order 2 or more, not {highest}")
    again = parts.detail
    comparisons = {}
    for order in range(2, highest + 1):
        again = separate(again, shape_filter=parts.shape_filter).detail
        comparisons[order] = compare_details(again, parts.detail)
    return comparisons


@dataclass(frozen=True)
class ChainStep:
    """One step of a chain that transfers a detail from target to target.

    Parameters
    ----------
    target
        Index of the target that received the detail.
    to_previous, to_original
        Comparison of the detail separated from the result with the transferred detail, and with
        the detail of the source.
    shape_mae_deg
        Mean angle between the shape of the target and the shape of the result.
    pixels
        Number of pixels, the same in all steps.
    """

    target: int
    to_previous: DetailComparison
    to_original: DetailComparison
    shape_mae_deg: float
    pixels: int

    __repr__ = short_repr


def transfer_chain(
    source: NormalMap,
    targets: Sequence[NormalMap],
    *,
    shape_filter: ShapeFilter = ShapeFilter(),
) -> tuple[ChainStep, ...]:
    """Transfer a detail from target to target and back to the first, separating it each time.

    All maps are first cropped to the same size, each to the middle of the largest rectangle inside
    its mask, so that every pixel takes part in all steps.

    Parameters
    ----------
    source
        The map whose detail is transferred.
    targets
        The maps that receive the detail, in this order; the first also receives it last.
    shape_filter
        The filter that separates the maps.

    Returns
    -------
    tuple[ChainStep, ...]
        One step for each target in order, and a last step for the first target.

    Raises
    ------
    DataError
        If there is no target, or the filter's window is larger than the cropped maps.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.detail import transfer_chain
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> hill = NormalMap.from_vectors(np.dstack([-x, -y, 0 * x + 2]))
    >>> ripples = NormalMap.from_vectors(np.dstack([0.2 * np.sin(40 * x), 0 * x, 0 * x + 1]))
    >>> len(transfer_chain(ripples, [bowl, hill]))
    3
    """
    if not targets:
        raise DataError("a chain of transfers requires at least one target")
    first, *others = _crop_to_common_size([source, *targets])
    original = separate(first, shape_filter=shape_filter).detail
    shapes = [shape_filter.shape(other) for other in others]
    detail = original
    steps = []
    for index in [*range(len(others)), 0]:
        separated = separate(combine(shapes[index], detail), shape_filter=shape_filter)
        steps.append(
            ChainStep(
                index,
                to_previous=compare_details(separated.detail, detail),
                to_original=compare_details(separated.detail, original),
                shape_mae_deg=angular_error(separated.shape, shapes[index]).mae_deg,
                pixels=first.mask.size,
            )
        )
        detail = separated.detail
    return tuple(steps)


def cross_exchange(
    a: NormalMap,
    b: NormalMap,
    *,
    shape_filter: ShapeFilter = ShapeFilter(),
) -> tuple[TransferResult, TransferResult]:
    """Transfer the detail of each of two maps to the shape of the other; a smaller map is repeated.

    Parameters
    ----------
    a, b
        The maps, of any sizes.
    shape_filter
        The filter that separates the maps.

    Returns
    -------
    tuple[TransferResult, TransferResult]
        The detail of a on b, and the detail of b on a, with errors on demand.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.detail import cross_exchange
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> ripples = NormalMap.from_vectors(np.dstack([0.2 * np.sin(40 * x), 0 * x, 0 * x + 1]))
    >>> rippled_bowl, flattened_bowl = cross_exchange(ripples, bowl)
    >>> rippled_bowl.normal_map
    NormalMap(float32[32, 32, 3], 1024 normals)
    """
    return (
        transfer(a, b, shape_filter=shape_filter, tile="plain"),
        transfer(b, a, shape_filter=shape_filter, tile="plain"),
    )


def _crop_to_common_size(maps: Sequence[NormalMap]) -> list[NormalMap]:
    rectangles = [largest_rectangle(one.mask) for one in maps]
    width, height = (min(box[k] for box in rectangles) for k in (2, 3))
    cropped = []
    for one, (x, y, wide, high) in zip(maps, rectangles, strict=True):
        left, top = x + (wide - width) // 2, y + (high - height) // 2
        normals = one.normals[top : top + height, left : left + width]
        cropped.append(NormalMap(normals, np.ones((height, width), np.bool_)))
    return cropped
