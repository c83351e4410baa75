"""``sgp compare``: the difference between two normal maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from sgp.cli.options import Green, Input, OptionalInput, Pixels
from sgp.results import CompareMetrics, Result, claim_folder, figures_of, writes_folder
from sgp.stages import MapInput


@writes_folder("compare.json")
def compare(
    a: Input,
    b: Input,
    *,
    mask: OptionalInput = None,
    green: Green = "up",
    out: Path | None = None,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Compare two normal maps: angular error, SSIM, error map.

    All pixels of the mask count; a pixel without a normal in A counts as an error of 90 degrees.

    For example:

        sgp compare out/normals truth.exr --mask mask.png --out comparison

    Parameters
    ----------
    a
        Map to evaluate: image of normals, or folder with normals.* and mask.png, such as a result.
    b
        Reference map.
    mask
        Mask image of the pixels that count; default: all pixels with a normal in B.
    green
        Direction of the green channel in image files.
    out
        Folder for error.exr, error.png and compare.json; without it, nothing is written.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    first, second = (MapInput(path, green, max_pixels=max_pixels).read() for path in (a, b))
    counted = None if mask is None else acquisition.read_mask(mask, second.normal_map.size)
    error = processing.angular_error(first.normal_map, second.normal_map, counted)
    if not error.coverage:
        masks = "masks" if mask is None else f"masks and {mask}"
        raise acquisition.DataError(
            f"{a} and {b}: their {masks} do not overlap: there is nothing to compare"
        )
    maps = first.normal_map, second.normal_map
    where = second.normal_map.mask if counted is None else counted
    metrics = figures_of(
        CompareMetrics,
        error,
        ssim=processing.ssim(*maps, where),
        ssim_paper=processing.ssim(*maps, where, protocol="paper"),
    )
    result = Result(
        metrics=metrics,
        warnings=[*first.warnings, *second.warnings],
        inputs=[*first.files, *second.files, *([] if mask is None else [mask])],
    )
    result.summary = [
        f"angular error  mean {error.mae_deg:.3f} deg, median {error.median_deg:.3f} deg",
        f"coverage       {error.coverage:.2%} of {np.isfinite(error.map_deg).sum()} pixels",
        f"SSIM           {metrics['ssim']:.4f} over the mask, "
        f"{metrics['ssim_paper']:.4f} in the paper's protocol",
    ]
    if out is not None:
        from sgp.pictures import map_panel, write_overview

        claim_folder(out, "compare.json")
        result.outputs = {"error": out / "error.exr", "picture": out / "error.png"}
        acquisition.write_exr(result.outputs["error"], error.map_deg)
        names = " against ".join(distinct_names(a, b))
        title = f"{names}: mean {error.mae_deg:.2f} deg, coverage {error.coverage:.1%}"
        panel = map_panel(title, error.map_deg, "deg", error=True)
        write_overview(result.outputs["picture"], "Angular error", [panel], columns=1)
    return result


def distinct_names(a: Path, b: Path) -> tuple[str, str]:
    """Return the ends of two paths, long enough to differ; the names if the paths are the same."""
    parts = a.absolute().parts, b.absolute().parts
    for count in range(1, 1 + max(map(len, parts))):
        ends = tuple(str(Path(*path[-count:])) for path in parts)
        if ends[0] != ends[1]:
            return ends[0], ends[1]
    return a.name, b.name
