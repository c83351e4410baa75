"""Figures of a transfer of detail, from sums over rows that do not depend on bands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from processing._detail.seam import SeamSteps, steps_of_sums
from processing._detail.separation import sums_of_rows
from processing._metrics import Protocol, mean_similarity, similarity_of_rows

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_PROTOCOLS: tuple[Protocol, ...] = ("masked", "paper")
# Columns of the sums: errors, errors with the paper's filter, similarities, steps.
COLUMNS = 2 + 2 + 4 + 4


@dataclass(frozen=True)
class TransferFigures:
    """Figures of a transfer.

    Parameters
    ----------
    shape_mae_deg, detail_mae_deg
        Mean errors of `TransferFidelity`.
    shape_mae_deg_paper, detail_mae_deg_paper
        The same with the paper's filter.
    shape_ssim, shape_ssim_paper, detail_ssim, detail_ssim_paper
        Similarities of the shapes and of the details, over the pixels that received detail and in
        the protocol of the paper.
    seam
        Steps of the detail across the borders of copies, and inside.
    pixels
        Number of the pixels that received detail.
    """

    shape_mae_deg: float
    detail_mae_deg: float
    shape_mae_deg_paper: float
    detail_mae_deg_paper: float
    shape_ssim: float
    shape_ssim_paper: float
    detail_ssim: float
    detail_ssim_paper: float
    seam: SeamSteps
    pixels: int

    @classmethod
    def of_sums(cls, sums: Double, received: Mask) -> TransferFigures:
        """Return the figures of the sums ``(H, COLUMNS)`` of all rows."""
        pixels = int(np.count_nonzero(received))
        columns = [np.ascontiguousarray(column) for column in sums.T]
        shape, detail, shape_paper, detail_paper = (
            float(column.sum() / pixels) for column in columns[:4]
        )
        similar = [
            mean_similarity(column, received, protocol)
            for column, protocol in zip(columns[4:8], 2 * _PROTOCOLS, strict=True)
        ]
        return cls(
            shape_mae_deg=shape,
            detail_mae_deg=detail,
            shape_mae_deg_paper=shape_paper,
            detail_mae_deg_paper=detail_paper,
            shape_ssim=similar[0],
            shape_ssim_paper=similar[1],
            detail_ssim=similar[2],
            detail_ssim_paper=similar[3],
            seam=steps_of_sums(sums[:, 8:]),
            pixels=pixels,
        )


def error_sums(errors: tuple[Float, Float], received: Mask) -> Double:
    """Return ``(n, 2)`` sums over rows of two maps of errors."""
    return np.stack([sums_of_rows(values, received) for values in errors], axis=1)


def similarity_sums(
    pairs: tuple[tuple[Float, Float], tuple[Float, Float]], mask: Mask, received: Mask
) -> Double:
    """Return ``(n, 4)`` sums over rows of the similarities of shapes and of details.

    Parameters
    ----------
    pairs
        Shapes of result and target, then details of the result and of the source.
    mask, received
        Where the target has a normal, and where it received detail.
    """
    masks = (mask, mask), (mask, received)
    return np.stack(
        [
            similarity_of_rows(*pair, known, received, protocol)
            for pair, known in zip(pairs, masks, strict=True)
            for protocol in _PROTOCOLS
        ],
        axis=1,
    )
