"""``sgp detail transfer``: transfer detail from one map to another, globally or locally."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from cyclopts import Parameter

import acquisition
import processing
import rig
from sgp._console import Stages
from sgp._detail_metrics import TransferMetrics
from sgp._exit import UsageError
from sgp._map_doubts import read_map
from sgp._options import (
    Count,
    Degrees,
    Factor,
    Input,
    OptionalInput,
    Order,
    Pixels,
    Positive,
    Steps,
    numbers,
)
from sgp._output import claim_folder, writes_folder
from sgp._overview import write_overview
from sgp._panels.crop import Crop
from sgp._panels.maps import map_panel, normals_panel
from sgp._result import Result
from sgp._stage_options import MapOptions
from sgp._write_profile import write_height_profile

Green = Literal["up", "down"]
_MAPS = MapOptions()
Mask = npt.NDArray[np.bool_]
# Both numbers may be negative.
Place = Annotated[str, Parameter(allow_leading_hyphen=True)]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class LocalOptions:
    """Options for transferring a part of the source into the target.

    Parameters
    ----------
    source_mask
        Mask image of the source region; this or any of the next four options makes the transfer
        local.
    target_mask
        Mask image of the target region: pixels outside it stay unchanged.
    scale
        Scale factor of the source region.
    rotate_deg
        Rotation of the source region in degrees, counter-clockwise.
    mirror
        Mirror the source region left to right.
    """

    source_mask: OptionalInput = None
    target_mask: OptionalInput = None
    scale: Positive = 1.0
    rotate_deg: Degrees = 0.0
    mirror: bool = False


@writes_folder("normals.json")
def transfer(
    source: Input,
    target: Input,
    *,
    out: Path,
    keep_target_detail: bool = False,
    amplitude: Factor = 1.0,
    refine: Steps = 0,
    filter: processing.FilterKind = "gaussian",  # noqa: A002
    order: Order = 8,
    w: Count | None = None,
    at: Place | None = None,
    tile: processing.Tile = "cut",
    local: LocalOptions = LocalOptions(),
    profile: bool = False,
    source_green: Green = "up",
    target_green: Green = "up",
    written: MapOptions = _MAPS,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    r"""Transfer the detail of one normal map to the shape of another, globally or locally.

    A source smaller than the target is repeated, a larger one is cropped. Only --scale resizes.

    For example:

        sgp detail transfer leather.png out/normals --out leathery
        sgp detail transfer cat bear --source-mask face.png --at 303,188 \
            --scale 1.2 --rotate-deg 6 --out bearcat

    Parameters
    ----------
    source
        Normal map whose detail is used.
    target
        Normal map whose shape is used.
    out
        Folder for normals.exr, normals.png, mask.png, shape_error.exr, detail_error.exr,
        errors.png and normals.json.
    keep_target_detail
        Add the detail to the target's normals instead of its shape component (as in the paper's
        table).
    amplitude
        Factor on the slopes of the detail; negative values invert the relief.
    refine
        Number of correction steps; each about halves the shape error and raises the detail error
        by half.
    filter
        Low-pass filter for the shape component: gaussian, box, guided or bilateral. The last two
        do not smooth across steps and occlusions.
    order
        Order of the Gaussian; the paper uses 1.
    w
        Half width of the filter window in pixels; sigma is w / 2. A larger window
        gives coarser detail; default: 5, or 10 for a local transfer.
    at
        Position (x,y) in the target, column and row, of the source's first pixel; for a local
        transfer, of the centre of the source region.
    tile
        How copies of a smaller source are joined: cut (they overlap and are joined along cuts where
        they differ least), plain (repeated), or mirror (every second copy is mirrored).
    profile
        Integrate target and result, and write height_profile.png and .csv.
    source_green
        Direction of the green channel in the source.
    target_green
        Direction of the green channel in the target.
    written
        Form of the PNG.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    place = None if at is None else numbers("--at", at, 2)
    is_local = local != LocalOptions()
    if is_local and (keep_target_detail or refine):
        raise UsageError("--keep-target-detail and --refine cannot be used in a local transfer")
    if tile != "cut" and (is_local or place is not None):
        raise UsageError(
            "--tile cannot be used with --at or in a local transfer: only one copy is placed"
        )
    first = read_map(source, green=source_green, option="--source-green", max_pixels=max_pixels)
    second = read_map(target, green=target_green, option="--target-green", max_pixels=max_pixels)
    maps = first.normal_map, second.normal_map
    done: processing.TransferResult | processing.LocalTransferResult
    with Stages() as progress:
        if is_local:
            done = processing.transfer_local(
                *maps,
                source_mask=_mask(local.source_mask, maps[0]),
                target_mask=_mask(local.target_mask, maps[1]),
                pose=processing.Pose(
                    None if place is None else (place[0], place[1]),
                    local.scale,
                    local.rotate_deg,
                    local.mirror,
                ),
                amplitude=amplitude,
                shape_filter=processing.ShapeFilter(filter, order, 10 if w is None else w),
                on_progress=progress,
            )
        else:
            done = processing.transfer(
                *maps,
                keep_target_detail=keep_target_detail,
                amplitude=amplitude,
                refine=refine,
                shape_filter=processing.ShapeFilter(filter, order, 5 if w is None else w),
                at=None if place is None else _whole(place),
                tile=tile,
                on_progress=progress,
            )
    masks = [path for path in (local.source_mask, local.target_mask) if path is not None]
    result = Result(
        warnings=[*first.warnings, *second.warnings],
        inputs=[*first.files, *second.files, *masks],
    )
    claim_folder(out, "normals.json")
    with Stages() as progress:
        result.outputs = processing.write_normals(
            out, done.normal_map, green=written.green_out, on_progress=progress
        )
    title = f"Detail of {source.name} on {target.name}"
    with Stages() as progress:
        metrics = _write_errors(out, title, done, result, progress)
    if profile:
        metrics = {**metrics, **write_height_profile(out, maps[1], done.normal_map, result)}
    result.metrics = metrics
    return result


def _mask(path: Path | None, normal_map: processing.NormalMap) -> Mask | None:
    return None if path is None else acquisition.read_mask(path, normal_map.size)


def _whole(place: list[float]) -> tuple[int, int]:
    if not all(value.is_integer() for value in place):
        raise UsageError("--at must be whole pixels, except in a local transfer")
    return int(place[0]), int(place[1])


def _write_errors(
    out: Path,
    title: str,
    done: processing.TransferResult | processing.LocalTransferResult,
    result: Result,
    on_progress: rig.Progress,
) -> TransferMetrics:
    """Write error maps and their picture, and return the figures."""
    # Steps of about the same duration.
    steps = 7
    on_progress("measuring errors", 0, steps)
    own = done.fidelity
    on_progress("measuring errors", 1, steps)
    paper = done.fidelity_paper
    on_progress("measuring errors", 2, steps)
    maps = {"shape": own.shape_error_deg, "detail": own.detail_error_deg}
    means = {"shape": own.shape_mae_deg, "detail": own.detail_mae_deg}
    crop = Crop.around(done.normal_map.mask)
    panels = [normals_panel("Result", done.normal_map, crop)]
    for name, values in maps.items():
        result.outputs[f"{name}_error"] = out / f"{name}_error.exr"
        acquisition.write_exr(result.outputs[f"{name}_error"], values)
        error = f"{name.capitalize()} error, mean {means[name]:.2f} deg"
        panels.append(map_panel(error, values, "deg", crop, error=True))
    result.outputs["errors_picture"] = out / "errors.png"
    write_overview(result.outputs["errors_picture"], title, panels, columns=3)
    on_progress("measuring errors", 3, steps)
    shapes, details = (own.result.shape, own.shape), (own.result.detail, own.detail)
    received = own.detail.mask
    similar = []
    for pair in (shapes, details):
        similar.append(processing.ssim(*pair, received))
        on_progress("measuring errors", 3 + len(similar), steps)
        similar.append(processing.ssim(*pair, protocol="paper"))
        on_progress("measuring errors", 3 + len(similar), steps)
    metrics: TransferMetrics = {
        "shape_mae_deg": own.shape_mae_deg,
        "detail_mae_deg": own.detail_mae_deg,
        "shape_mae_deg_paper": paper.shape_mae_deg,
        "detail_mae_deg_paper": paper.detail_mae_deg,
        "shape_ssim": similar[0],
        "shape_ssim_paper": similar[1],
        "detail_ssim": similar[2],
        "detail_ssim_paper": similar[3],
        "pixels": int(received.sum()),
    }
    result.summary = [
        _where(done),
        f"shape error   {own.shape_mae_deg:.2f} deg (paper's filter {paper.shape_mae_deg:.2f})",
        f"detail error  {own.detail_mae_deg:.2f} deg (paper's filter {paper.detail_mae_deg:.2f})",
    ]
    is_local = isinstance(done, processing.LocalTransferResult)
    if not isinstance(done, processing.LocalTransferResult):
        metrics["source_window"] = done.placement.source_window
        metrics["tiles"] = done.placement.tiles
    if is_local or metrics["tiles"] != (1, 1):
        seam = done.seam
        metrics["seam_step_deg"] = seam.seam_deg
        metrics["interior_step_deg"] = seam.interior_deg
        metrics["seam_ratio"] = seam.ratio
        result.summary.append(
            f"{'seam' if is_local else 'borders':13} {seam.seam_deg:.2f} deg per pixel, interior "
            f"{seam.interior_deg:.2f}"
        )
    return metrics


def _where(done: processing.TransferResult | processing.LocalTransferResult) -> str:
    if isinstance(done, processing.LocalTransferResult):
        return f"detail transferred to {rig.pluralize(int(done.region.sum()), 'pixel')}"
    x, y, width, height = done.placement.source_window
    across, down = done.placement.tiles
    return f"{width} x {height} pixels of the source from {x},{y}, tiled {across} x {down} times"
