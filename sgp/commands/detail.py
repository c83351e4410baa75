"""``sgp detail``: split normal maps into shape and detail, and put them together again."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from acquisition import write_exr
from processing import FilterKind, read_normals, ssim, write_normals
from processing import combine as combine_maps
from processing import separate as separate_map
from processing import transfer as transfer_detail
from sgp._options import Count, Factor, Order, Steps, numbers
from sgp._output import claim_folder, writes_folder
from sgp._result import Result
from sgp._write import write_separation

Green = Literal["up", "down"]


@writes_folder("detail.json")
def separate(
    normals: Path,
    *,
    out: Path,
    filter: FilterKind = "gaussian",  # noqa: A002
    order: Order = 8,
    w: Count = 5,
    green: Green = "up",
    force: bool = False,
) -> Result:
    """Split a normal map into its shape component and its detail component.

    `sgp detail combine` of the two gives the map back.

    For example:

        sgp detail separate out/normals --out parts

    Parameters
    ----------
    normals
        An image of normals, or a folder with normals.* and mask.png.
    out
        Folder for shape.exr, detail.exr, the same as 16-bit PNG, mask.png and detail.json.
    filter
        Low-pass filter that makes the shape.
    order
        Order of the Gaussian; 1 is the paper's.
    w
        Half width of the filter's window in pixels; sigma is w / 2.
    green
        Which way the green channel of an image file points.
    force
        Write into a folder that holds files already.
    """
    read = read_normals(normals, green=green)
    parts = separate_map(read.normal_map, filter=filter, order=order, w=w)
    result = write_separation(claim_folder(out, "detail.json"), parts)
    result.warnings += read.warnings
    result.inputs = list(read.files)
    return result


@writes_folder("normals.json")
def combine(
    shape: Path,
    detail: Path,
    *,
    out: Path,
    force: bool = False,
) -> Result:
    """Put a detail component onto a shape component of the same size.

    For example:

        sgp detail combine parts/shape.exr edited-detail.png --out back

    Parameters
    ----------
    shape
        The shape component.
    detail
        The detail component, edited or not.
    out
        Folder for normals.exr, normals.png, mask.png and normals.json.
    force
        Write into a folder that holds files already.
    """
    first, second = read_normals(shape), read_normals(detail)
    combined = combine_maps(first.normal_map, second.normal_map)
    return Result(
        outputs=write_normals(claim_folder(out, "normals.json"), combined),
        metrics={"pixels": int(combined.mask.sum())},
        warnings=[*first.warnings, *second.warnings],
        summary=[f"{int(combined.mask.sum())} normals in {out}"],
        inputs=[*first.files, *second.files],
    )


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
    w: Count = 5,
    at: str | None = None,
    source_green: Green = "up",
    target_green: Green = "up",
    force: bool = False,
) -> Result:
    """Carry the detail of one normal map onto the shape of another.

    Nothing is resized: a source smaller than the target is repeated, a larger one is cropped.

    For example:

        sgp detail transfer leather.png out/normals --out leathery

    Parameters
    ----------
    source
        The map whose detail is taken.
    target
        The map whose shape is kept.
    out
        Folder for normals.exr, normals.png, mask.png, detail_error.exr, detail_error.png and
        normals.json.
    keep_target_detail
        Put the detail onto the target's own normals instead of onto its shape (the paper's table).
    amplitude
        Factor on the slopes of the detail; negative inverts the relief.
    refine
        Correction steps: each about halves the shape error and raises the detail error by half.
    filter
        Low-pass filter that makes the shape.
    order
        Order of the Gaussian; 1 is the paper's.
    w
        Half width of the filter's window in pixels.
    at
        Column and row (x,y) of the target where the source's first pixel goes.
    source_green
        Which way the green channel of the source points.
    target_green
        Which way the green channel of the target points.
    force
        Write into a folder that holds files already.
    """
    place = None
    if at is not None:
        x, y = numbers("--at", at, 2)
        place = round(x), round(y)
    first = read_normals(source, green=source_green)
    second = read_normals(target, green=target_green)
    done = transfer_detail(
        first.normal_map,
        second.normal_map,
        keep_target_detail=keep_target_detail,
        amplitude=amplitude,
        refine=refine,
        filter=filter,
        order=order,
        w=w,
        at=place,
    )
    from sgp._overview import map_panel, write_overview

    claim_folder(out, "normals.json")
    result = Result(
        warnings=[*first.warnings, *second.warnings],
        inputs=[*first.files, *second.files],
    )
    result.outputs = write_normals(out, done.normal_map)
    result.outputs |= {
        "detail_error": out / "detail_error.exr",
        "detail_error_picture": out / "detail_error.png",
    }
    write_exr(result.outputs["detail_error"], done.fidelity.detail_error_deg)
    own, paper = done.fidelity, done.fidelity_paper
    panel = map_panel(f"mean {own.detail_mae_deg:.2f} deg", own.detail_error_deg, "deg", error=True)
    write_overview(result.outputs["detail_error_picture"], "Detail error", [panel], columns=1)
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
        f"shape error   {own.shape_mae_deg:.2f} deg (paper's filter {paper.shape_mae_deg:.2f})",
        f"detail error  {own.detail_mae_deg:.2f} deg (paper's filter {paper.detail_mae_deg:.2f})",
    ]
    return result
