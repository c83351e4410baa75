"""``sgp detail``: split normal maps into shape and detail, and put them together again."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from processing import FilterKind, read_normals, write_normals
from processing import combine as combine_maps
from processing import separate as separate_map
from rig import MAX_PIXELS
from sgp._options import Count, Order, Pixels
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
    max_pixels: Pixels = MAX_PIXELS,
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
        Low-pass filter that makes the shape: gaussian, box, or guided or bilateral, which stop at
        steps and occlusions.
    order
        Order of the Gaussian; 1 is the paper's.
    w
        Half width of the filter's window in pixels; sigma is w / 2.
    green
        Which way the green channel of an image file points.
    max_pixels
        Refuse images of more pixels, before they are decoded.
    force
        Write into a folder that holds files already.
    """
    read = read_normals(normals, green=green, max_pixels=max_pixels)
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
    max_pixels: Pixels = MAX_PIXELS,
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
    max_pixels
        Refuse images of more pixels, before they are decoded.
    force
        Write into a folder that holds files already.
    """
    first, second = (read_normals(path, max_pixels=max_pixels) for path in (shape, detail))
    combined = combine_maps(first.normal_map, second.normal_map)
    warnings = [*first.warnings, *second.warnings]
    known = int(combined.mask.sum())
    lost = int(first.normal_map.mask.sum()) - known
    if lost:
        warnings.append(f"{detail}: {lost} pixels of the shape have no detail and are left out")
    return Result(
        outputs=write_normals(claim_folder(out, "normals.json"), combined),
        metrics={"pixels": known},
        warnings=warnings,
        summary=[f"{known} normals in {out}"],
        inputs=[*first.files, *second.files],
    )
