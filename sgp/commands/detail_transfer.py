"""``sgp detail transfer``: the detail of one map on the shape of another, all over or in a part."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from cyclopts import Parameter

from acquisition import read_mask, write_exr
from processing import (
    FilterKind,
    LocalTransferResult,
    NormalMap,
    TransferResult,
    read_normals,
    ssim,
    write_normals,
)
from processing import transfer as transfer_detail
from processing import transfer_local as transfer_part
from rig import MAX_PIXELS
from sgp._exit import UsageError
from sgp._options import Count, Degrees, Factor, Order, Pixels, Positive, Steps, numbers
from sgp._output import claim_folder, writes_folder
from sgp._overview import map_panel, normals_panel, write_overview
from sgp._result import Result
from sgp._write_profile import write_height_profile

Green = Literal["up", "down"]
Mask = npt.NDArray[np.bool_]
# Either number may be negative.
Place = Annotated[str, Parameter(allow_leading_hyphen=True)]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class LocalOptions:
    """How a part of the source is set into the target.

    Parameters
    ----------
    source_mask
        Image of the part that is taken; this or any of the next four makes the transfer local.
    target_mask
        Image of where it may go.
    scale
        Factor on the size of the part.
    rotate_deg
        Turn of the part, counter-clockwise.
    mirror
        Exchange left and right of the part.
    """

    source_mask: Path | None = None
    target_mask: Path | None = None
    scale: Positive = 1.0
    rotate_deg: Degrees = 0.0
    mirror: bool = False


@writes_folder("normals.json")
def transfer(
    source: Path,
    target: Path,
    *,
    out: Path,
    keep_target_detail: bool = False,
    amplitude: Factor = 1.0,
    refine: Steps = 0,
    filter: FilterKind = "gaussian",  # noqa: A002
    order: Order = 8,
    w: Count | None = None,
    at: Place | None = None,
    local: LocalOptions = LocalOptions(),
    profile: bool = False,
    source_green: Green = "up",
    target_green: Green = "up",
    max_pixels: Pixels = MAX_PIXELS,
    force: bool = False,
) -> Result:
    r"""Carry the detail of one normal map onto the shape of another, all over or in a part.

    A source smaller than the target is repeated, a larger one is cropped. Only --scale resizes.

    For example:

        sgp detail transfer leather.png out/normals --out leathery
        sgp detail transfer cat bear --source-mask face.png --at 303,188 \
            --scale 1.2 --rotate-deg 6 --out bearcat

    Parameters
    ----------
    source
        The map whose detail is taken.
    target
        The map whose shape is kept.
    out
        Folder for normals.exr, normals.png, mask.png, shape_error.exr, detail_error.exr,
        errors.png and normals.json.
    keep_target_detail
        Put the detail onto the target's own normals instead of onto its shape (the paper's table).
    amplitude
        Factor on the slopes of the detail; negative inverts the relief.
    refine
        Correction steps: each about halves the shape error and raises the detail error by half.
    filter
        Low-pass filter that makes the shape: gaussian, box, or guided or bilateral, which stop at
        steps and occlusions.
    order
        Order of the Gaussian; 1 is the paper's.
    w
        Half width of the filter's window in pixels; sigma is w / 2. The larger, the
        coarser is the detail; default: 5, of a local transfer 10.
    at
        Column and row (x,y) of the target where the source's first pixel goes; of a local transfer
        where the middle of its part goes.
    profile
        Integrate target and result, and write height_profile.png and .csv.
    source_green
        Which way the green channel of the source points.
    target_green
        Which way the green channel of the target points.
    max_pixels
        Refuse images of more pixels, before they are decoded.
    force
        Write into a folder that holds files already.
    """
    place = None if at is None else numbers("--at", at, 2)
    is_local = local != LocalOptions()
    if is_local and (keep_target_detail or refine):
        raise UsageError("--keep-target-detail and --refine are not for a part of the source")
    first = read_normals(source, green=source_green, max_pixels=max_pixels)
    second = read_normals(target, green=target_green, max_pixels=max_pixels)
    maps = first.normal_map, second.normal_map
    done: TransferResult | LocalTransferResult
    if is_local:
        done = transfer_part(
            *maps,
            source_mask=_mask(local.source_mask, maps[0]),
            target_mask=_mask(local.target_mask, maps[1]),
            at=None if place is None else (place[0], place[1]),
            scale=local.scale,
            rotate_deg=local.rotate_deg,
            mirror=local.mirror,
            amplitude=amplitude,
            filter=filter,
            order=order,
            w=10 if w is None else w,
        )
    else:
        done = transfer_detail(
            *maps,
            keep_target_detail=keep_target_detail,
            amplitude=amplitude,
            refine=refine,
            filter=filter,
            order=order,
            w=5 if w is None else w,
            at=None if place is None else _whole(place),
        )
    masks = [path for path in (local.source_mask, local.target_mask) if path is not None]
    result = Result(
        warnings=[*first.warnings, *second.warnings],
        inputs=[*first.files, *second.files, *masks],
    )
    claim_folder(out, "normals.json")
    result.outputs = write_normals(out, done.normal_map)
    _write_errors(out, done, result)
    if profile:
        write_height_profile(out, maps[1], done.normal_map, result)
    return result


def _mask(path: Path | None, normal_map: NormalMap) -> Mask | None:
    return None if path is None else read_mask(path, normal_map.size)


def _whole(place: list[float]) -> tuple[int, int]:
    if not all(value.is_integer() for value in place):
        raise UsageError("--at must be whole pixels: without a part nothing is resampled")
    return int(place[0]), int(place[1])


def _write_errors(out: Path, done: TransferResult | LocalTransferResult, result: Result) -> None:
    """Write error maps and their picture, and add the figures."""
    own, paper = done.fidelity, done.fidelity_paper
    maps = {"shape": own.shape_error_deg, "detail": own.detail_error_deg}
    means = {"shape": own.shape_mae_deg, "detail": own.detail_mae_deg}
    panels = [normals_panel("Result", done.normal_map)]
    for name, values in maps.items():
        result.outputs[f"{name}_error"] = out / f"{name}_error.exr"
        write_exr(result.outputs[f"{name}_error"], values)
        title = f"{name.capitalize()} error, mean {means[name]:.2f} deg"
        panels.append(map_panel(title, values, "deg", error=True))
    result.outputs["errors_picture"] = out / "errors.png"
    write_overview(result.outputs["errors_picture"], "Transfer", panels, columns=3)
    for fidelity, suffix in ((own, ""), (paper, "_paper")):
        result.metrics |= {
            f"shape_mae_deg{suffix}": fidelity.shape_mae_deg,
            f"detail_mae_deg{suffix}": fidelity.detail_mae_deg,
        }
    pairs = {"shape": (own.result.shape, own.shape), "detail": (own.result.detail, own.detail)}
    for name, (found, meant) in pairs.items():
        result.metrics[f"{name}_ssim"] = ssim(found, meant, own.detail.mask)
        result.metrics[f"{name}_ssim_paper"] = ssim(found, meant, protocol="paper")
    result.summary = [
        _where(done),
        f"shape error   {own.shape_mae_deg:.2f} deg (paper's filter {paper.shape_mae_deg:.2f})",
        f"detail error  {own.detail_mae_deg:.2f} deg (paper's filter {paper.detail_mae_deg:.2f})",
    ]
    result.metrics["pixels"] = int(own.detail.mask.sum())
    if isinstance(done, LocalTransferResult):
        result.metrics |= {
            "seam_step_deg": done.seam.seam_deg,
            "interior_step_deg": done.seam.interior_deg,
            "seam_ratio": done.seam.ratio,
        }
        result.summary.append(
            f"seam          {done.seam.seam_deg:.2f} deg a pixel, interior "
            f"{done.seam.interior_deg:.2f}"
        )
    else:
        result.metrics["source_window"] = done.placement.source_window
        result.metrics["tiles"] = done.placement.tiles


def _where(done: TransferResult | LocalTransferResult) -> str:
    if isinstance(done, LocalTransferResult):
        return f"{int(done.region.sum())} pixels set in"
    x, y, width, height = done.placement.source_window
    across, down = done.placement.tiles
    return f"{width} x {height} pixels of the source from {x},{y}, laid {across} x {down} times"
