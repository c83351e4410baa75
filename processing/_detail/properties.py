"""What the paper claims of detail, as figures: separable, transferable, idempotent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition import DataError
from processing._detail.placement import largest_rectangle
from processing._detail.separation import Separation, combine, separate_by
from processing._detail.shape_filter import FilterKind, ShapeFilter
from processing._detail.transfer import TransferResult, transfer
from processing._metrics import angular_error, ssim
from processing._normal_map import NormalMap


@dataclass(frozen=True)
class DetailLikeness:
    """How much one detail is like another.

    Parameters
    ----------
    mae_deg
        Mean angle.
    ssim
        Structural similarity over the mask.
    ssim_paper
        The same in the paper's protocol; see `processing.ssim`.
    """

    mae_deg: float
    ssim: float
    ssim_paper: float


def detail_likeness(detail: NormalMap, meant: NormalMap) -> DetailLikeness:
    """Compare two details of one size.

    Raises
    ------
    DataError
        If the sizes disagree.
    """
    return DetailLikeness(
        angular_error(detail, meant).mae_deg,
        ssim(detail, meant),
        ssim(detail, meant, protocol="paper"),
    )


def idempotence(parts: Separation, highest: int = 4) -> dict[int, DetailLikeness]:
    """Take the detail of a detail again and again, and compare each with the first.

    Parameters
    ----------
    parts
        A separation; its detail is order 1.
    highest
        The last order, 2 or more.

    Returns
    -------
    dict[int, DetailLikeness]
        By order, from 2 on.

    Raises
    ------
    DataError
        If `highest` is below 2.
    """
    if highest < 2:
        raise DataError(f"the detail of a detail is of order 2 or more, not {highest}")
    again = parts.detail
    likeness = {}
    for order in range(2, highest + 1):
        again = separate_by(parts.shape_filter, again).detail
        likeness[order] = detail_likeness(again, parts.detail)
    return likeness


@dataclass(frozen=True)
class ChainStep:
    """One station of a detail that is handed on from target to target.

    Parameters
    ----------
    target
        Index of the target it was put onto.
    to_previous, to_original
        Likeness of the detail taken off there to the one put on, and to the source's.
    shape_mae_deg
        Mean angle between the target's shape and that of the result.
    pixels
        How many there were, the same at every station.
    """

    target: int
    to_previous: DetailLikeness
    to_original: DetailLikeness
    shape_mae_deg: float
    pixels: int


def transfer_chain(
    source: NormalMap,
    targets: Sequence[NormalMap],
    *,
    filter: FilterKind = "gaussian",  # noqa: A002
    order: int = 8,
    w: int = 5,
) -> tuple[ChainStep, ...]:
    """Hand a detail from target to target and back to the first, taking it off each time.

    So that every pixel goes the whole way, all maps are cut to one size first: each to the middle
    of the largest rectangle inside its mask.

    Parameters
    ----------
    source
        The map whose detail is handed on.
    targets
        Where it goes, in this order, and then to the first again.
    filter, order, w
        The shape filter; see `ShapeFilter`.

    Returns
    -------
    tuple[ChainStep, ...]
        One for each target in order, and one for the first again.

    Raises
    ------
    DataError
        If there is no target, or the filter's window is larger than the common cut.
    """
    if not targets:
        raise DataError("a chain of transfers needs at least one target")
    shape_filter = ShapeFilter(filter, order, w)
    first, *others = _common_cut([source, *targets])
    original = separate_by(shape_filter, first).detail
    shapes = [shape_filter.shape(other) for other in others]
    detail = original
    steps = []
    for index in [*range(len(others)), 0]:
        found = separate_by(shape_filter, combine(shapes[index], detail))
        steps.append(
            ChainStep(
                index,
                to_previous=detail_likeness(found.detail, detail),
                to_original=detail_likeness(found.detail, original),
                shape_mae_deg=angular_error(found.shape, shapes[index]).mae_deg,
                pixels=first.mask.size,
            )
        )
        detail = found.detail
    return tuple(steps)


def cross_exchange(
    a: NormalMap,
    b: NormalMap,
    *,
    filter: FilterKind = "gaussian",  # noqa: A002
    order: int = 8,
    w: int = 5,
) -> tuple[TransferResult, TransferResult]:
    """Put the detail of each of two maps onto the shape of the other.

    Parameters
    ----------
    a, b
        The maps, of any sizes.
    filter, order, w
        The shape filter; see `ShapeFilter`.

    Returns
    -------
    tuple[TransferResult, TransferResult]
        a's detail on b and b's on a, with errors on demand.
    """
    return (
        transfer(a, b, filter=filter, order=order, w=w),
        transfer(b, a, filter=filter, order=order, w=w),
    )


def _common_cut(maps: Sequence[NormalMap]) -> list[NormalMap]:
    rectangles = [largest_rectangle(one.mask) for one in maps]
    width, height = (min(box[k] for box in rectangles) for k in (2, 3))
    cut = []
    for one, (x, y, wide, high) in zip(maps, rectangles, strict=True):
        left, top = x + (wide - width) // 2, y + (high - height) // 2
        normals = one.normals[top : top + height, left : left + width]
        cut.append(NormalMap(normals, np.ones((height, width), np.bool_)))
    return cut
