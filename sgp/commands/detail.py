"""``sgp detail``: split normal maps into shape and detail, and put them together again."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from acquisition import write_exr
from processing import combine as combine_maps
from processing import read_normals, ssim, write_normals
from processing import separate as separate_map
from processing import transfer as transfer_detail
from sgp._inputs import normal_files
from sgp._output import writes_folder
from sgp._result import Result
from sgp._write import write_separation

Filter = Literal["gaussian", "box"]
Green = Literal["up", "down"]


@writes_folder("detail.json")
def separate(
    normals: Path,
    *,
    out: Path,
    filter: Filter = "gaussian",  # noqa: A002
    order: int = 8,
    w: int = 5,
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
    out.mkdir(parents=True, exist_ok=True)
    result = write_separation(out, parts)
    result.warnings += read.warnings
    result.inputs = normal_files(normals)
    return result


@writes_folder("normals.json")
def combine(
    shape: Path,
    detail: Path,
    *,
    out: Path,
    green: Green = "up",
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
    green
        Which way the green channel of image files points.
    force
        Write into a folder that holds files already.
    """
    first, second = read_normals(shape, green=green), read_normals(detail, green=green)
    combined = combine_maps(first.normal_map, second.normal_map)
    out.mkdir(parents=True, exist_ok=True)
    return Result(
        outputs=write_normals(out, combined),
        metrics={"pixels": int(combined.mask.sum())},
        warnings=[*first.warnings, *second.warnings],
        summary=[f"{int(combined.mask.sum())} normals in {out}"],
        inputs=[*normal_files(shape), *normal_files(detail)],
    )


@writes_folder("normals.json")
def transfer(
    source: Path,
    target: Path,
    *,
    out: Path,
    keep_target_detail: bool = False,
    amplitude: float = 1.0,
    refine: int = 0,
    filter: Filter = "gaussian",  # noqa: A002
    order: int = 8,
    w: int = 5,
    at: tuple[int, int] | None = None,
    green: Green = "up",
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
        Column and row of the target where the source's first pixel goes.
    green
        Which way the green channel of image files points.
    force
        Write into a folder that holds files already.
    """
    first, second = read_normals(source, green=green), read_normals(target, green=green)
    done = transfer_detail(
        first.normal_map,
        second.normal_map,
        keep_target_detail=keep_target_detail,
        amplitude=amplitude,
        refine=refine,
        filter=filter,
        order=order,
        w=w,
        at=at,
    )
    from sgp._overview import map_panel, write_overview

    out.mkdir(parents=True, exist_ok=True)
    result = Result(
        warnings=[*first.warnings, *second.warnings],
        inputs=[*normal_files(source), *normal_files(target)],
    )
    result.outputs = write_normals(out, done.normal_map)
    result.outputs |= {
        "detail_error": out / "detail_error.exr",
        "detail_error_picture": out / "detail_error.png",
    }
    write_exr(result.outputs["detail_error"], done.detail_error_deg)
    panel = map_panel(
        f"mean {done.detail_mae_deg:.2f} deg", done.detail_error_deg, "deg", error=True
    )
    write_overview(result.outputs["detail_error_picture"], "Detail error", [panel], columns=1)
    fidelity = done.fidelity
    result.metrics = {
        "shape_mae_deg": done.shape_mae_deg,
        "detail_mae_deg": done.detail_mae_deg,
        "shape_ssim": ssim(fidelity.result.shape, fidelity.shape, fidelity.detail.mask),
        "detail_ssim": ssim(fidelity.result.detail, fidelity.detail),
        "shape_mae_paper_deg": done.shape_mae_paper_deg,
        "detail_mae_paper_deg": done.detail_mae_paper_deg,
    }
    result.summary = [
        f"shape error   {done.shape_mae_deg:.2f} deg "
        f"(paper's filter {done.shape_mae_paper_deg:.2f})",
        f"detail error  {done.detail_mae_deg:.2f} deg "
        f"(paper's filter {done.detail_mae_paper_deg:.2f})",
    ]
    return result
