"""Figures and pictures of a transfer of detail."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from rig.arrays import Bool
from sgp.pictures import Crop, map_panel, normals_panel, write_overview
from sgp.results import Result, TransferMetrics, figures_of
from sgp.stages.maps import StageMaps


@dataclass(frozen=True)
class Transferred:
    """The result of a transfer with its figures, in memory or in files.

    Parameters
    ----------
    normals, mask
        ``(H, W, 3)`` and ``(H, W)``, its normals.
    shape_error_deg, detail_error_deg
        ``(H, W)`` errors, NaN where no detail was received.
    figures
        Mean errors, similarities and steps.
    placement
        Position of the source on the target; None for a local transfer.
    warnings, files
        Those of the readers.
    """

    normals: acquisition.MapRows
    mask: Bool
    shape_error_deg: acquisition.MapRows
    detail_error_deg: acquisition.MapRows
    figures: processing.detail.TransferFigures
    placement: processing.detail.Placement | None
    warnings: tuple[rig.Notice, ...]
    files: tuple[Path, ...]

    @classmethod
    def of_stage(cls, stage: processing.detail.TransferStage, made: StageMaps) -> Transferred:
        """Return the result of a transfer."""
        source, target = (given.mask for given in made.inputs)
        return cls(
            made.maps[stage.result],
            target,
            made.maps["shape_error"],
            made.maps["detail_error"],
            stage.figures(made.maps, target),
            stage.placement(made.maps, source, target),
            made.warnings,
            made.files,
        )

    @classmethod
    def of_part(
        cls,
        done: processing.detail.LocalTransferResult,
        source: processing.NormalMapFile,
        target: processing.NormalMapFile,
        on_progress: rig.Progress,
    ) -> Transferred:
        """Return the result of a local transfer, with the figures, which are computed here."""
        steps, own = 7, done.fidelity
        on_progress("measuring errors", 1, steps)
        paper = done.fidelity_paper
        on_progress("measuring errors", 2, steps)
        pairs = (own.result.shape, own.shape), (own.result.detail, own.detail)
        received, similar = own.detail.mask, []
        for pair in pairs:
            similar.append(processing.ssim(*pair, received))
            on_progress("measuring errors", 2 + len(similar), steps)
            similar.append(processing.ssim(*pair, protocol="paper"))
            on_progress("measuring errors", 2 + len(similar), steps)
        figures = processing.detail.TransferFigures(
            shape_mae_deg=own.shape_mae_deg,
            detail_mae_deg=own.detail_mae_deg,
            shape_mae_deg_paper=paper.shape_mae_deg,
            detail_mae_deg_paper=paper.detail_mae_deg,
            shape_ssim=similar[0],
            shape_ssim_paper=similar[1],
            detail_ssim=similar[2],
            detail_ssim_paper=similar[3],
            seam=done.seam,
            pixels=int(np.count_nonzero(received)),
        )
        on_progress("measuring errors", steps, steps)
        return cls(
            done.normal_map.normals,
            done.normal_map.mask,
            own.shape_error_deg,
            own.detail_error_deg,
            figures,
            None,
            (*source.warnings, *target.warnings),
            (*source.files, *target.files),
        )


def write_transfer(out: Path, title: str, done: Transferred, result: Result) -> TransferMetrics:
    """Write error maps and their picture, add the summary, and return the figures."""
    figures = done.figures
    maps = {"shape": done.shape_error_deg, "detail": done.detail_error_deg}
    means = {"shape": figures.shape_mae_deg, "detail": figures.detail_mae_deg}
    crop = Crop.around(done.mask)
    panels = [normals_panel("Result", done, crop)]
    for name, values in maps.items():
        acquisition.write_exr(result.file(f"{name}_error", out / f"{name}_error.exr"), values)
        error = f"{name.capitalize()} error, mean {means[name]:.2f} deg"
        panels.append(map_panel(error, values, "deg", crop, error=True))
    write_overview(result.file("errors_picture", out / "errors.png"), title, panels, columns=3)
    metrics = figures_of(TransferMetrics, figures)
    result.summary = [
        _where(done),
        f"shape error   {figures.shape_mae_deg:.2f} deg (paper's filter "
        f"{figures.shape_mae_deg_paper:.2f})",
        f"detail error  {figures.detail_mae_deg:.2f} deg (paper's filter "
        f"{figures.detail_mae_deg_paper:.2f})",
    ]
    placement, seam = done.placement, figures.seam
    if placement is not None:
        metrics["source_window"] = placement.source_window
        metrics["tiles"] = placement.tiles
    if placement is None or placement.tiles != (1, 1):
        metrics["seam_step_deg"] = seam.seam_deg
        metrics["interior_step_deg"] = seam.interior_deg
        metrics["seam_ratio"] = seam.ratio
        result.summary.append(
            f"{'seam' if placement is None else 'borders':13} {seam.seam_deg:.2f} deg per pixel, "
            f"interior {seam.interior_deg:.2f}"
        )
    return metrics


def _where(done: Transferred) -> str:
    if done.placement is None:
        return f"detail transferred to {rig.pluralize(done.figures.pixels, 'pixel')}"
    x, y, width, height = done.placement.source_window
    across, down = done.placement.tiles
    return f"{width} x {height} pixels of the source from {x},{y}, tiled {across} x {down} times"
