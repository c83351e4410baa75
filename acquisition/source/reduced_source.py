"""A region of a source, or the source at a lower resolution."""

from __future__ import annotations

import operator
from dataclasses import replace

import numpy as np

from acquisition._errors import DataError
from acquisition.source.source import Reduction, Source
from rig import check_type
from rig.arrays import Float32


def crop(source: Source, x: int, y: int, width: int, height: int) -> Source:
    """Return the source of a rectangular region.

    Mask, camera and true normals are those of the region; points in mm stay where they are. Frames
    are still read as they are stored, and `calibration.linear_stack` crops them.

    Parameters
    ----------
    source
        The recording; of a reduced source, the region is in its reduced pixels.
    x, y
        Column and row of the region's first pixel, from 0.
    width, height
        Size of the region in pixels.

    Returns
    -------
    Source
        Recording of the size ``(height, width)``.

    Raises
    ------
    DataError
        If the region is empty, extends beyond the image, or contains no pixel of the mask.
    TypeError
        If a number is not whole.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import crop, read_source, write_png
    >>> write_png("card.png", np.full((40, 60), 700, np.uint16))
    >>> crop(read_source("card.png"), 10, 5, 30, 20).size
    (20, 30)
    """
    check_type("source", source, Source, "read_source(path) returns one")
    x, y, width, height = map(operator.index, (x, y, width, height))
    rows, columns = source.size
    region = f"the region of {width} x {height} pixels from {x},{y}"
    inside = x >= 0 and y >= 0 and x + width <= columns and y + height <= rows
    if min(width, height) < 1 or not inside:
        raise DataError(
            f"{source.path}: {region} is not inside the images of {columns} x {rows} pixels"
        )
    old = _reduction(source)
    step, part = old.factor, Reduction(x, y, width, height)
    truth = source.normals_truth
    return replace(
        _masked(source, part, f"{region} contains no pixel of the mask"),
        reduction=Reduction(old.x + x * step, old.y + y * step, width * step, height * step, step),
        camera=None if source.camera is None else source.camera.cropped(x, y, width, height),
        normals_truth=None if truth is None else part.cut(truth).copy(),
    )


def downscale(source: Source, factor: int) -> Source:
    """Return the source at a lower resolution: ``factor x factor`` pixels become one.

    `calibration.linear_stack` averages linear radiance; a block with a saturated sample is not
    measured, since the average of the others would be too low. A pixel belongs to the mask if its
    complete block does, and has a true normal if its complete block has.

    Parameters
    ----------
    source
        The recording.
    factor
        Whole number, at least 1. Columns on the right and rows at the bottom that do not fill a
        block are left out.

    Returns
    -------
    Source
        Recording of the size ``(height // factor, width // factor)``.

    Raises
    ------
    DataError
        If the factor is less than 1 or larger than the image, or no block is completely within
        the mask.
    TypeError
        If the factor is not whole.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import downscale, read_source, write_png
    >>> write_png("card.png", np.full((40, 60), 700, np.uint16))
    >>> downscale(read_source("card.png"), 4).size
    (10, 15)
    """
    check_type("source", source, Source, "read_source(path) returns one")
    factor = operator.index(factor)
    rows, columns = source.size
    if factor < 1 or factor > min(rows, columns):
        raise DataError(
            f"{source.path}: images of {columns} x {rows} pixels cannot be reduced by a factor of "
            f"{factor}: give 1 to {min(rows, columns)}"
        )
    if factor == 1:
        return source
    old, truth = _reduction(source), source.normals_truth
    blocks = Reduction(0, 0, columns, rows, factor)
    nothing = (
        f"no block of {factor} x {factor} pixels is completely within the mask: give a smaller "
        "factor"
    )
    return replace(
        _masked(source, blocks, nothing),
        reduction=replace(old, factor=old.factor * factor),
        shifts_px={
            name: (right / factor, down / factor)
            for name, (right, down) in source.shifts_px.items()
        },
        camera=None if source.camera is None else source.camera.downscaled(factor),
        normals_truth=None if truth is None else _mean_normals(blocks, truth),
    )


def _reduction(source: Source) -> Reduction:
    """Return the reduction of a source without the columns and rows that it does not use."""
    height, width = source.size
    if source.reduction is None:
        return Reduction(0, 0, width, height)
    step = source.reduction.factor
    return replace(source.reduction, width=width * step, height=height * step)


def _masked(source: Source, part: Reduction, nothing: str) -> Source:
    """Return a source with mask and other places of a reduction; ``nothing`` is the refusal."""
    mask = None if source.mask is None else part.all(source.mask)
    if mask is not None and not mask.any():
        raise DataError(f"{source.path}: {nothing}")
    elsewhere = source.not_object
    return replace(
        source, mask=mask, not_object=None if elsewhere is None else ~part.all(~elsewhere)
    )


def _mean_normals(blocks: Reduction, truth: Float32) -> Float32:
    known = blocks.all((truth != 0).any(axis=2))
    total = blocks.mean(truth)
    length = np.linalg.norm(total, axis=2, keepdims=True)
    usable = known[..., None] & (length > 0)
    unit: Float32 = np.divide(total, length, out=np.zeros_like(total), where=usable)
    return unit
