"""Figures and pictures of synthesised detail."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import acquisition
import processing
from rig.arrays import Bool
from sgp.cli.console import shown, with_progress
from sgp.pictures import Crop, lit_panel, write_overview
from sgp.results import Result, SynthesisMetrics, figures_of

_MOST_SHOWN = 700  # pixels of a side of a picture


@dataclass(frozen=True)
class Synthesised:
    """A synthesised detail.

    Parameters
    ----------
    normals, mask
        ``(H, W, 3)`` and ``(H, W)``, the detail.
    measured
        The part of which the figures are: a large sheet's middle.
    patch
        Side of the patches.
    steps
        Steps across cuts and inside patches.
    """

    normals: acquisition.MapRows
    mask: Bool
    measured: processing.NormalMap
    patch: int
    steps: processing.detail.SeamSteps

    @classmethod
    def in_memory(
        cls, made: processing.Synthesis | processing.synthesis.TargetSynthesis
    ) -> Synthesised:
        """Return a detail in memory."""
        detail = made.detail
        return cls(detail.normals, detail.mask, detail, made.patch, made.steps)

    @classmethod
    def of_sheet(
        cls, stage: processing.synthesis.SynthesisStage, maps: Mapping[str, acquisition.MapRows]
    ) -> Synthesised:
        """Return a sheet, of which the middle is measured."""
        middle = stage.middle(maps)
        steps, mask = stage.cut_steps(maps), np.ones(stage.size, np.bool_)
        return cls(maps["sheet"], mask, middle, stage.patch, steps)


def measure_texture(
    detail: Synthesised, exemplar: processing.NormalMap, result: Result
) -> SynthesisMetrics:
    """Compare synthesised detail with its exemplar, add the summary, and return the figures."""
    figures = processing.synthesis.texture_figures(detail.measured, exemplar, patch=detail.patch)
    # Each figure is computed when it is first used.
    named = [name for name in SynthesisMetrics.__annotations__ if hasattr(type(figures), name)]
    for name in shown("measuring", named):
        getattr(figures, name)
    steps = detail.steps
    height, width = detail.mask.shape
    pixels = np.count_nonzero(detail.mask)
    size = f"{width} x {height} pixels" if detail.mask.all() else f"{pixels} pixels"
    result.summary = [
        f"{size} from {np.count_nonzero(exemplar.mask)}",
        f"detail angle   {figures.detail_angle_deg:.2f} deg (exemplar "
        f"{figures.exemplar_angle_deg:.2f})",
        f"slopes differ by {figures.slope_distance:.1%} of their spread",
        f"spectrum       {_text(figures.spectrum_distance)} from the exemplar's (its halves "
        f"{_text(figures.exemplar_spectrum_distance)})",
        f"repeat score   {_text(figures.repeat_score)} (exemplar "
        f"{_text(figures.exemplar_repeat_score)})",
        f"steps          {_text(steps.seam_deg)} deg across cuts, {_text(steps.interior_deg)} "
        "inside patches",
    ]
    return figures_of(
        SynthesisMetrics, figures, cut_step_deg=steps.seam_deg, inside_step_deg=steps.interior_deg
    )


def measure_transfer(
    made: processing.synthesis.TargetSynthesis,
    shape: processing.NormalMap,
    normals: processing.NormalMap,
    shape_filter: processing.ShapeFilter,
    result: Result,
) -> dict[str, float]:
    """Separate the result again, add to the summary, and return the figures."""
    again = with_progress(processing.separate)(normals, shape_filter=shape_filter)
    fidelity = processing.detail.TransferFidelity(shape, made.detail, again)
    pair = (fidelity.result.detail, fidelity.detail)
    result.summary += [
        f"shape error    {fidelity.shape_mae_deg:.2f} deg, detail error "
        f"{fidelity.detail_mae_deg:.2f}",
        f"compressed     {made.compressed:.1%} of the pixels: the exemplar is too small for them",
    ][: 2 if made.compressed else 1]
    return {
        "shape_mae_deg": fidelity.shape_mae_deg,
        "detail_mae_deg": fidelity.detail_mae_deg,
        "detail_ssim": processing.ssim(*pair, made.detail.mask),
        "detail_ssim_paper": processing.ssim(*pair, protocol="paper"),
        "compressed_share": made.compressed,
    }


def _text(value: float) -> str:
    return "unknown" if np.isnan(value) else f"{value:.2f}"


def write_sheet_picture(
    path: Path, title: str, sheet: Synthesised, exemplar: processing.NormalMap
) -> None:
    """Draw the exemplar, a part of the sheet at the same scale, and the complete sheet."""
    height, width = sheet.mask.shape
    side = min(*exemplar.size, _MOST_SHOWN)
    part = Crop(slice(0, min(side, height)), slice(0, min(side, width)))
    panels = [
        lit_panel("exemplar", exemplar),
        lit_panel("upper left part of the sheet", sheet, part),
        lit_panel(f"sheet, {width} x {height} pixels", sheet),
    ]
    write_overview(path, title, panels, columns=3)


def write_target_picture(
    path: Path,
    title: str,
    exemplar: processing.NormalMap,
    target: processing.NormalMap,
    normals: processing.NormalMap,
) -> None:
    """Draw the exemplar, the target, and the target with the synthesised detail."""
    crop = Crop.around(target.mask)
    panels = [
        lit_panel("exemplar", exemplar),
        lit_panel("target", target, crop),
        lit_panel("result", normals, crop),
    ]
    write_overview(path, title, panels, columns=3)
