"""How well images, lights and normals of a recording agree, and what probably does not."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import cv2
import numpy as np

from acquisition import DataError, Lights, TransferCurve
from processing.checks import limits
from processing.checks.block_model import BlockModel, Blocks
from processing.checks.derivatives import slopes_of
from processing.checks.explanation import Explanation, Recorded, explain, robust_normals
from processing.checks.shown_lights import shown_lights
from processing.checks.verdict import Cause, Verdict
from processing.images.block_means import Cells, cells_of
from processing.images.recorded_images import Images
from processing.images.viewing_rays import SurfacePoints, View
from processing.surface.integrability_test import integrability
from rig import Notice, short_repr
from rig.arrays import Bool, Float64

# Side of the part of the object in which movements are sought.
_DETAIL_PX = 120
# Notices about the height that the causes explain.
_COMPARED = {"height-doubtful"}


class Examined(NamedTuple):
    """A recording, before its normals are computed.

    Parameters
    ----------
    images
        The N images that are used: linear radiance under lights of intensity 1, NaN where
        saturated.
    lights
        Their N lights.
    mask
        ``(H, W)`` bool, the object.
    points
        Points of the surface for lights with positions, else None.
    view
        How pixels see these points; None under distant lights.
    strengths
        ``(N,)`` recorded signal relative to the samples; None if it is the same for all.
    pixel_mm
        Size of a pixel on the object; None if it is not known.
    transfer
        The assumed transfer curve; None if it is certain.
    """

    images: Images
    lights: Lights
    mask: Bool
    points: Float64 | SurfacePoints | None
    view: View | None = None
    strengths: Float64 | None = None
    pixel_mm: float | None = None
    transfer: TransferCurve | None = None


@dataclass(frozen=True, eq=False)
class ImageQuality:
    """Agreement of the images of an object with their lights and with each other.

    Parameters
    ----------
    residual
        Median over the object of the rms deviation of the samples from a matte surface under the
        lights, relative to the signal, 0..1. Samples in shadow do not count.
    consistency
        The same for the best three images whose combinations are all others, whatever the lights;
        NaN if there are fewer than 5 images.
    used
        Share 0..1 of the samples of the object that are neither saturated nor in shadow.
    image_residual
        ``(N,)`` median absolute deviation of each image from the lights, relative to the signal.
    light_error_deg
        ``(N,)`` angle between each light and the light that its image shows, compared with the
        other images; NaN with fewer than 8 images, or if the object is too flat to show it. A
        common rotation or reflection of all lights cannot be seen.
    light_gain
        ``(N,)`` brightness of each image relative to its light, NaN in the same cases.
    curl
        Disagreement of the mixed derivatives of the normals, see `integrability`: 0 for a surface,
        1 for a mirrored one, about 0.7 for noise; NaN with too few pixels.
    ids
        Names of the N lights.
    explanation
        What is probably wrong.
    """

    residual: float
    consistency: float
    used: float
    image_residual: Float64
    light_error_deg: Float64
    light_gain: Float64
    curl: float
    ids: tuple[str, ...]
    explanation: Explanation = field(repr=False)

    __repr__ = short_repr

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What is probably wrong, by evidence."""
        return self.explanation.causes

    def verdict(self, sigma_deg: float, doubts: Iterable[Notice] = ()) -> Verdict:
        """Return whether normals of this recording can be used.

        Parameters
        ----------
        sigma_deg
            Stated standard deviation of the normals: the median, in degrees; NaN if not known.
        doubts
            What else contradicts the recording.
        """
        found = self.explanation
        others = [one for one in doubts if not (found.tried and one.code in _COMPARED)]
        causes = [*found.causes, *(_cause(notice) for notice in others)]
        # The causes that an unknown effect makes harmful, too, before smaller ones.
        causes.sort(key=lambda cause: -np.nan_to_num(cause.normals_deg, nan=np.inf))
        verdict = Verdict(
            tuple(causes),
            sigma_deg=sigma_deg,
            residual=self.residual,
            noise=self.consistency,
            unexplained_deg=self._unexplained_deg(sigma_deg),
            tried=found.tried,
            not_excluded=found.not_excluded,
            least=found.least,
        )
        # What does not matter needs no remedy, whose own error may be larger.
        needed = (
            cause if cause.matters(verdict.matters_deg) else replace(cause, remedy="")
            for cause in causes
        )
        return replace(verdict, causes=tuple(needed))

    def _unexplained_deg(self, sigma_deg: float) -> float:
        """Return what the residual does that causes and reflectance leave; 0 if both are small.

        Standard deviations contain an estimate of what the whole residual does.
        """
        if sigma_deg > limits.UNCERTAIN_DEG:
            return sigma_deg
        if self.residual < limits.GOOD:
            return 0.0
        return sigma_deg * float(np.sqrt(self.explanation.unexplained))


def image_quality(
    values: Images,
    lights: Lights,
    mask: Bool,
    *,
    points_mm: Float64 | None = None,
) -> ImageQuality:
    """Test whether images, lights and the normals that follow from them agree.

    The tests use means over about 16,000 cells of the object, so that their cost does not grow
    with the size of the images apart from one pass over them.

    Parameters
    ----------
    values
        ``(N, H, W)`` float32 linear radiance under lights of intensity 1, NaN where saturated.
    lights
        The N lights.
    mask
        ``(H, W)`` bool, the object.
    points_mm
        ``(H, W, 3)`` surface points for lights with positions, as for `photometric_stereo`.

    Returns
    -------
    ImageQuality
        Figures and causes.

    Raises
    ------
    DataError, EstimateError
        As `photometric_stereo`.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from processing.checks import image_quality
    >>> around = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    >>> lights = Lights(directions=np.stack([np.cos(around), np.sin(around), 0 * around + 2], 1))
    >>> y, x = np.mgrid[0.7:-0.7:48j, -0.7:0.7:48j]
    >>> normals = np.dstack([x, y, np.sqrt(1 - x**2 - y**2)])
    >>> values = np.einsum("nk,hwk->nhw", lights.unit_directions, normals).clip(0)
    >>> image_quality(values.astype(np.float32), lights, np.ones((48, 48), bool)).causes
    ()
    """
    if not mask.any():
        raise DataError("the mask is empty: there is no pixel to compute")
    return quality_of(Examined(values, lights, mask, points_mm))


def quality_of(examined: Examined) -> ImageQuality:
    """Return `image_quality` of a recording."""
    images, lights, mask, points, view, strengths, pixel_mm, transfer = examined
    cells = cells_of(images, mask, points)
    if not cells.mask.any():
        unknown = np.full(len(lights), np.nan)
        return ImageQuality(
            np.nan, np.nan, np.nan, unknown, unknown, unknown, np.nan, lights.ids, Explanation()
        )
    blocks = Blocks(cells, pixel_mm)

    def turned(i: int, signs: tuple[int, int]) -> Float64:
        image = np.ascontiguousarray(images[i][:: signs[0], :: signs[1]])
        means = cells_of(image[None], mask, None).values[0]
        return np.asarray(means.reshape(-1)[blocks.places] / blocks.scale, np.float64)

    normals = robust_normals(blocks, lights, range(len(lights)))
    shape = integrability(normals.normals, normals.mask)
    model = blocks.fit(lights)
    shown = shown_lights(model)
    if strengths is None:
        strengths = np.ones(len(lights))
    detail = None
    part = _most_detailed(model, mask, cells)
    if part is not None:
        detail = Blocks(cells_of(images, part, points), pixel_mm)
    recorded = Recorded(
        blocks, lights, strengths, view, pixel_mm, transfer, normals, shape, turned, detail
    )
    return ImageQuality(
        residual=shown.residual,
        consistency=shown.consistency,
        used=shown.used,
        image_residual=shown.image_residual,
        light_error_deg=shown.error_deg,
        light_gain=shown.gain,
        curl=shape.curl,
        ids=lights.ids,
        explanation=explain(recorded, model, shown),
    )


def _most_detailed(model: BlockModel, mask: Bool, cells: Cells) -> Bool | None:
    """Return the part of the object where normals change most; None if cells are pixels."""
    if cells.size == 1:
        return None
    energy = np.zeros(model.places.shape)
    for slope in slopes_of(model):
        energy += (np.nan_to_num(slope / model.albedo[:, None]) ** 2).sum(axis=1)
    # Outlines have the largest changes.
    energy = np.minimum(energy, 4 * float(np.median(energy)))
    grid = np.zeros(model.shape, np.float32)
    grid.reshape(-1)[model.places] = energy
    side = max(_DETAIL_PX // cells.size, 1)
    sums = cv2.boxFilter(grid, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    row, column = (int(at) * cells.size for at in divmod(int(np.argmax(sums)), model.shape[1]))
    rows, columns = (
        slice(max(corner + at - _DETAIL_PX // 2, 0), corner + at + _DETAIL_PX // 2)
        for corner, at in zip(cells.corner, (row, column), strict=True)
    )
    part = np.zeros_like(mask)
    part[rows, columns] = mask[rows, columns]
    return part if part.any() else None


def _cause(notice: Notice) -> Cause:
    text, _, remedy = notice.text.rpartition("; ")
    if not text:
        text, remedy = notice.text, ""
    return Cause(notice.code, text, remedy=remedy, where=notice.where)
