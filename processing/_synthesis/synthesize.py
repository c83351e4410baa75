"""Synthesis of a detail component of any size by quilting patches of an exemplar."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._normal_map import NormalMap, check_normal_map
from processing._stages.stage import computed
from processing._synthesis.quilting import overlap_of
from processing._synthesis.seam_steps import CutSteps, cut_steps
from processing._synthesis.synthesis_stage import SynthesisStage
from rig import Progress, no_progress


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A synthesised detail component.

    Parameters
    ----------
    detail
        The sheet: unit vectors of the exemplar, known everywhere.
    labels
        ``(H, W)`` uint8: pixels of the same patch have the same number, pixels of patches that
        touch have different ones.
    patch, overlap
        Side of the patches, and the least width of their overlap, in pixels.
    tileable
        Whether the last column and row continue at the first ones.
    """

    detail: NormalMap
    labels: npt.NDArray[np.uint8]
    patch: int
    overlap: int
    tileable: bool

    def __repr__(self) -> str:
        used = f"patch={self.patch}, overlap={self.overlap}"
        return f"Synthesis({self.detail!r}, {used}{', tileable' if self.tileable else ''})"

    @cached_property
    def steps(self) -> CutSteps:
        """Mean angles between neighbouring normals, across cuts and inside patches."""
        return cut_steps(self.detail.normals, self.labels, wrapped=self.tileable)


def synthesize(
    exemplar: NormalMap,
    size: tuple[int, int],
    *,
    patch: int = 48,
    overlap: int | None = None,
    seed: int = 0,
    rotate: bool = False,
    mirror: bool = False,
    tileable: bool = False,
    on_progress: Progress = no_progress,
) -> Synthesis:
    """Continue a detail component over a sheet of any size by image quilting.

    Patches of the exemplar are placed in rows and columns so that they agree where they overlap,
    and are joined along cuts where they differ least (Efros and Freeman, *Image Quilting for
    Texture Synthesis and Transfer*, 2001). Flat and steep parts of the exemplar are used as often
    as they occur, so that the sheet is as steep as the exemplar. Where the mean step across cuts is
    larger than inside patches, the two pixels at each cut take a small share of each other. One
    filter gives the sheet the spectrum of the exemplar. All vectors have unit length.

    Parameters
    ----------
    exemplar
        Detail component, for instance of `separate`. Patches lie inside its mask.
    size
        (height, width) of the sheet in pixels.
    patch
        Side of the square patches in pixels, at least 6. Structures larger than a patch are lost.
    overlap
        Width of the overlap of neighbouring patches in pixels, 2 to a third of the patch. Default:
        a quarter of the patch.
    seed
        Fixes all random choices, 0 to 2^63 - 1. The result does not depend on the number of
        threads.
    rotate, mirror
        Also use copies of the exemplar that are turned by 90, 180 and 270 degrees, or mirrored,
        with their normals.
    tileable
        The last column and row continue at the first ones, so that the sheet can be repeated.
    on_progress
        Receives the stage ``synthesising``, in rows of all steps.

    Returns
    -------
    Synthesis
        The sheet, float32.

    Raises
    ------
    DataError
        If the exemplar is smaller than a patch, flat, or its mask has no room for a patch; if a
        number is out of range; if the sheet is too small for tiling or too large for the memory.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, synthesize
    >>> noise = np.random.default_rng(0).normal(scale=0.2, size=(64, 64, 3))
    >>> rough = NormalMap.from_vectors(noise + [0, 0, 1])
    >>> synthesize(rough, (100, 150), patch=16).detail
    NormalMap(float32[100, 150, 3], 15000 normals)
    """
    check_normal_map("exemplar", exemplar)
    stage = SynthesisStage(size, patch, overlap, seed, rotate, mirror, tileable)
    try:
        maps = computed(stage, exemplar, on_progress=on_progress)
        mask = np.ones(size, np.bool_)
    except MemoryError as error:
        raise DataError(
            f"a sheet of {size[1]} x {size[0]} pixels does not fit into the memory: it needs "
            f"{14 * size[0] * size[1] / 1e9:.1f} GB"
        ) from error
    detail = NormalMap.of_unit_vectors(maps["sheet"][:], mask)
    return Synthesis(detail, maps["labels"][:], patch, overlap_of(patch, overlap), tileable)
