"""``sgp detail fill``: fill damaged or missing parts of a normal map from their surroundings."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from sgp.cli.console import with_progress
from sgp.cli.options import Count, Green, Input, Pixels, Seed
from sgp.pictures import Crop, lit_panel, write_overview
from sgp.results import FillMetrics, Result, claim_folder, figures_of, writes_folder
from sgp.stages import MAPS, SEPARATION, MapInput, MapOptions, SeparationOptions


@writes_folder("fill.json")
def fill(
    normals: Input,
    *,
    holes: Input,
    out: Path,
    patch: Count = 12,
    overlap: Count | None = None,
    seed: Seed = 0,
    options: SeparationOptions = SEPARATION,
    green: Green = "up",
    maps: MapOptions = MAPS,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Fill damaged or missing parts of a normal map from their surroundings.

    The shape is continued smoothly into each hole, and patches of the surrounding detail are put
    on it. Normals outside the holes do not change.

    For example:

        sgp detail fill out/normals --holes scratches.png --out repaired

    Parameters
    ----------
    normals
        Image of normals, or folder with normals.* and mask.png, such as a result.
    holes
        Mask image of the parts to fill, white where the normals are damaged or missing.
    out
        Folder for normals.exr and normals.png, mask.png, invented.png (white in the holes),
        fill.png and fill.json.
    patch
        Side of the square patches in pixels.
    overlap
        Width of the known part that a patch continues, in pixels; default: a third of the patch.
    seed
        Seed of all random choices.
    options
        Low-pass filter that separates shape and detail.
    green
        Direction of the green channel in an image file.
    maps
        Form of the PNG.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    read = MapInput(normals, green, max_pixels=max_pixels).read()
    given = read.normal_map
    mask = acquisition.read_mask(holes, given.size)
    result = Result(warnings=list(read.warnings), inputs=[*read.files, holes])
    outside = int(np.count_nonzero(mask & ~given.mask))
    if outside:
        text = (
            f"{rig.pluralize(outside, 'pixel')} of the holes had no normal: the object is larger "
            "now"
        )
        result.warnings.append(rig.Notice("holes-without-normals", text, str(holes), "info"))
    filled = with_progress(processing.fill_holes)(
        given, mask, patch=patch, overlap=overlap, seed=seed, shape_filter=options.shape_filter()
    )
    claim_folder(out, "fill.json")
    result.outputs = maps.write_map(out, filled.normal_map)
    acquisition.write_mask(result.file("invented", out / "invented.png"), mask)
    _measure(filled, result)
    _write_picture(
        result.file("picture", out / "fill.png"), f"Holes of {normals.name} filled", filled, given
    )
    return result


def _measure(filled: processing.synthesis.FilledHoles, result: Result) -> None:
    seam = filled.seam
    metrics = figures_of(
        FillMetrics,
        filled,
        pixels=int(np.count_nonzero(filled.normal_map.mask)),
        filled_pixels=int(np.count_nonzero(filled.holes)),
        seam_step_deg=seam.seam_deg,
        interior_step_deg=seam.interior_deg,
        seam_ratio=seam.ratio,
    )
    result.metrics = metrics
    result.summary = [
        f"{rig.pluralize(metrics['filled_pixels'], 'pixel')} filled",
        f"detail angle  {filled.detail_angle_deg:.2f} deg (surroundings "
        f"{filled.surroundings_angle_deg:.2f})",
        f"rim           {seam.seam_deg:.2f} deg per pixel, interior {seam.interior_deg:.2f}",
    ]


def _write_picture(
    path: Path, title: str, filled: processing.synthesis.FilledHoles, given: processing.NormalMap
) -> None:
    """Draw the map with its holes, without them, and its detail."""
    crop = Crop.around(filled.normal_map.mask)
    known = given.mask & ~filled.holes
    left = processing.NormalMap(np.where(known[..., None], given.normals, 0), known)
    panels = [
        lit_panel("with holes", left, crop),
        lit_panel("filled", filled.normal_map, crop),
        lit_panel("detail", filled.detail, crop),
    ]
    write_overview(path, title, panels, columns=3)
