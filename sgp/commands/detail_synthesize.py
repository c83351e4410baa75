"""``sgp detail synthesize``: continue the detail of a map over a sheet of any size."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

import acquisition
import processing
import rig
from sgp._console import Stages, shown
from sgp._exit import UsageError
from sgp._options import Count, Input, Pixels, Region, Seed, image_size
from sgp._output import claim_folder, writes_folder
from sgp._overview import write_overview
from sgp._panels.crop import Crop
from sgp._panels.maps import lit_panel
from sgp._result import Result
from sgp._stage_options import MapOptions, SeparationOptions

_SEPARATION, _MAPS = SeparationOptions(), MapOptions()
# A detail whose shape component is tilted by more than this share of the detail itself has shape.
_MOST_SHAPE = 0.5
_MOST_SHOWN = 700  # pixels of a side of a picture
_FIGURES = (
    "detail_angle_deg",
    "exemplar_angle_deg",
    "slope_distance",
    "spectrum_distance",
    "exemplar_spectrum_distance",
    "repeat_score",
    "exemplar_repeat_score",
)


@writes_folder("synthesize.json")
def synthesize(
    exemplar: Input,
    *,
    size: str,
    out: Path,
    is_detail: bool = False,
    crop: Region | None = None,
    patch: Count = 48,
    overlap: Count | None = None,
    seed: Seed = 0,
    rotate: bool = False,
    mirror: bool = False,
    tileable: bool = False,
    options: SeparationOptions = _SEPARATION,
    green: Literal["up", "down"] = "up",
    maps: MapOptions = _MAPS,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Continue the detail of a normal map over a sheet of any size.

    Patches of the exemplar are joined along cuts where they differ least. The result is a detail
    component, which `sgp detail combine` puts on a shape of the same size, and it is itself the
    normal map of a flat sheet.

    For example:

        sgp detail synthesize hide.png --size 2048x2048 --tileable --out sheet

    Parameters
    ----------
    exemplar
        Image of normals, or folder with normals.* and mask.png.
    size
        Width and height of the sheet in pixels (WxH).
    out
        Folder for detail.exr and detail.png, mask.png, invented.png (white where a pixel was
        synthesised: here everywhere), synthesis.png and synthesize.json.
    is_detail
        The exemplar is a detail component; it is not separated again.
    crop
        Region x,y,w,h of the exemplar to use, in pixels.
    patch
        Side of the square patches in pixels; it should exceed the largest structures.
    overlap
        Width of the overlap of patches in pixels; default: a quarter of the patch.
    seed
        Seed of all random choices.
    rotate
        Also use the exemplar turned by 90, 180 and 270 degrees.
    mirror
        Also use the mirrored exemplar.
    tileable
        Let the last column and row continue at the first, so that the sheet can be repeated.
    options
        Low-pass filter that separates the exemplar.
    green
        Direction of the green channel in an image file.
    maps
        Form of the PNG.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    width, height = image_size("--size", size)
    read = processing.read_normals(exemplar, green=green, max_pixels=max_pixels)
    result = Result(warnings=list(read.warnings), inputs=list(read.files))
    with Stages() as progress:
        detail = read.normal_map
        if not is_detail:
            parts = processing.separate(
                detail, shape_filter=options.shape_filter(), on_progress=progress
            )
            detail = parts.detail
        if crop is not None:
            detail = _cropped(detail, crop, exemplar)
        if is_detail:
            result.warnings += _shape_notice(detail, options.shape_filter(), exemplar)
        made = processing.synthesize(
            detail,
            (height, width),
            patch=patch,
            overlap=overlap,
            seed=seed,
            rotate=rotate,
            mirror=mirror,
            tileable=tileable,
            on_progress=progress,
        )
    claim_folder(out, "synthesize.json")
    with Stages() as progress:
        result.outputs = processing.write_normals(
            out, made.detail, "detail", green=maps.green_out, on_progress=progress
        )
    result.outputs["invented"] = out / "invented.png"
    acquisition.write_mask(result.outputs["invented"], made.detail.mask)
    _measure(made, detail, result)
    result.outputs["picture"] = out / "synthesis.png"
    _write_picture(result.outputs["picture"], f"Synthesis from {exemplar.name}", made, detail)
    return result


def _cropped(
    detail: processing.NormalMap, crop: tuple[int, int, int, int], path: Path
) -> processing.NormalMap:
    x, y, width, height = crop
    rows, columns = detail.size
    if min(x, y) < 0 or min(width, height) < 1 or x + width > columns or y + height > rows:
        raise UsageError(
            f"--crop {x},{y},{width},{height} leaves the {columns} x {rows} pixels of {path}: give "
            "x,y,w,h inside"
        )
    window = slice(y, y + height), slice(x, x + width)
    if not detail.mask[window].any():
        raise UsageError(f"--crop {x},{y},{width},{height}: no normal of {path} is inside")
    return processing.NormalMap(detail.normals[window], detail.mask[window])


def _shape_notice(
    detail: processing.NormalMap, shape_filter: processing.ShapeFilter, path: Path
) -> list[rig.Notice]:
    """Return a notice if a map that was given as a detail component contains shape."""
    if min(detail.size) <= 2 * shape_filter.w:
        return []  # too small to separate; the synthesis decides whether a patch fits
    z = np.array([0, 0, 1], np.float32)
    shape = shape_filter.shape(detail).normals[detail.mask]
    left = float(np.mean(processing.angle_deg(shape, z), dtype=np.float64))
    whole = float(np.mean(processing.angle_deg(detail.normals[detail.mask], z), dtype=np.float64))
    if left <= _MOST_SHAPE * whole:
        return []
    text = (
        f"the exemplar contains shape: its low-pass part is tilted by {left:.1f} degrees on "
        f"average (separability), the map itself by {whole:.1f}; omit --is-detail to separate it"
    )
    return [rig.Notice("exemplar-with-shape", text, str(path))]


def _measure(
    made: processing.Synthesis,
    exemplar: processing.NormalMap,
    result: Result,
) -> None:
    """Compare the sheet with the exemplar, and add figures and summary."""
    figures = processing.texture_figures(made.detail, exemplar, patch=made.patch)
    values: dict[str, float] = {}
    for name in shown("measuring", _FIGURES):
        values[name] = getattr(figures, name)
    steps = made.steps
    result.metrics = {
        **values,
        "cut_step_deg": steps.across_deg,
        "inside_step_deg": steps.inside_deg,
    }
    height, width = made.detail.size
    result.summary = [
        f"{width} x {height} pixels from {np.count_nonzero(exemplar.mask)}",
        f"detail angle   {figures.detail_angle_deg:.2f} deg (exemplar "
        f"{figures.exemplar_angle_deg:.2f})",
        f"slopes differ by {figures.slope_distance:.1%} of their spread",
        f"spectrum       {_text(figures.spectrum_distance)} from the exemplar's (its halves "
        f"{_text(figures.exemplar_spectrum_distance)})",
        f"repeat score   {_text(figures.repeat_score)} (exemplar "
        f"{_text(figures.exemplar_repeat_score)})",
        f"steps          {_text(steps.across_deg)} deg across cuts, {_text(steps.inside_deg)} "
        "inside patches",
    ]


def _text(value: float) -> str:
    return "unknown" if np.isnan(value) else f"{value:.2f}"


def _write_picture(
    path: Path, title: str, made: processing.Synthesis, exemplar: processing.NormalMap
) -> None:
    """Draw the exemplar, a part of the sheet at the same scale, and the complete sheet."""
    height, width = made.detail.size
    side = min(*exemplar.size, _MOST_SHOWN)
    part = Crop(slice(0, min(side, height)), slice(0, min(side, width)))
    panels = [
        lit_panel("exemplar", exemplar),
        lit_panel("upper left part of the sheet", made.detail, part),
        lit_panel(f"sheet, {width} x {height} pixels", made.detail),
    ]
    write_overview(path, title, panels, columns=3)
