"""Split normal maps into shape and detail; combine, transfer, fill, enlarge them.

For example:

    sgp detail separate out/normals --out parts
    sgp detail transfer leather.png out/normals --out leathery
"""

from __future__ import annotations

from pathlib import Path

import processing
import rig
from sgp.cli.options import Green, Input, Memory, Pixels
from sgp.results import CombineMetrics, Result, claim_folder, writes_folder
from sgp.stages import (
    MAPS,
    SEPARATION,
    Limit,
    MapInput,
    MapOptions,
    SeparationOptions,
    stage_maps,
    write_separation,
)


@writes_folder("detail.json")
def separate(
    normals: Input,
    *,
    out: Path,
    options: SeparationOptions = SEPARATION,
    green: Green = "up",
    maps: MapOptions = MAPS,
    memory: Memory | None = None,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Split a normal map into its shape component and its detail component.

    `sgp detail combine` of the two components restores the map.

    For example:

        sgp detail separate out/normals --out parts

    Parameters
    ----------
    normals
        Image of normals, or folder with normals.* and mask.png, such as a result.
    out
        Folder for shape.exr, detail.exr, both also as 16-bit PNG, mask.png and detail.json.
    options
        Low-pass filter.
    green
        Direction of the green channel in an image file.
    maps
        Form of the PNGs.
    memory
        Memory to use, such as 3G or 500M; default: half of what is free. Maps that do not fit are
        computed in bands of rows, in files in the output folder; the same command continues them
        if it was interrupted.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    limit = Limit(memory, out / "detail", force)
    given = MapInput(normals, green, max_pixels=max_pixels)
    with stage_maps(options.stage(), [given], limit) as made:
        folder = claim_folder(out, "detail.json")
        result = write_separation(folder, made.maps, made.inputs[0].mask, maps)
    result.warnings += made.warnings
    result.inputs = list(made.files)
    return result


@writes_folder("normals.json")
def combine(
    shape: Input,
    detail: Input,
    *,
    out: Path,
    maps: MapOptions = MAPS,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Combine a shape component and a detail component of the same size into a normal map.

    For example:

        sgp detail combine parts/shape.exr edited-detail.png --out back

    Parameters
    ----------
    shape
        Shape component.
    detail
        Detail component, edited or not.
    out
        Folder for normals.exr, normals.png, mask.png and normals.json.
    maps
        Form of the PNG.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    first, second = (
        MapInput(path, option=None, max_pixels=max_pixels).read() for path in (shape, detail)
    )
    combined = processing.combine(first.normal_map, second.normal_map)
    warnings = [*first.warnings, *second.warnings]
    count = int(combined.mask.sum())
    lost = int(first.normal_map.mask.sum()) - count
    if lost:
        words = (
            "pixel of the shape has no detail and is",
            "pixels of the shape have no detail and are",
        )
        text = f"{rig.pluralize(lost, *words)} masked out"
        warnings.append(rig.Notice("shape-without-detail", text, str(detail)))
    return Result(
        outputs=maps.write_map(claim_folder(out, "normals.json"), combined),
        metrics=CombineMetrics(pixels=count),
        warnings=warnings,
        summary=[f"{rig.pluralize(count, 'normal')} in {out}"],
        inputs=[*first.files, *second.files],
    )
