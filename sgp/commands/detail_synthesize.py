"""``sgp detail synthesize``: continue the detail of a map over a sheet or over a target."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

import acquisition
import processing
import rig
from sgp.cli.console import with_progress
from sgp.cli.exit import UsageError
from sgp.cli.options import (
    Count,
    Green,
    Input,
    Memory,
    OptionalInput,
    Pixels,
    Region,
    Seed,
    image_size,
)
from sgp.results import Result, claim_folder, writes_folder
from sgp.stages import (
    MAPS,
    SEPARATION,
    GuidanceOptions,
    Limit,
    MapInput,
    MapOptions,
    SeparationOptions,
    Synthesised,
    identity,
    maps_in_files,
    measure_texture,
    measure_transfer,
    options_of,
    write_sheet_picture,
    write_target_picture,
)

_GUIDANCE = GuidanceOptions()
# A detail whose shape component is tilted by more than this share of the detail itself has shape.
_MOST_SHAPE = 0.5
# Arguments that a synthesis of a sheet and one on a target have in common.
_PLACING = ("patch", "overlap", "seed", "rotate", "mirror")


@writes_folder("synthesize.json")
def synthesize(
    exemplar: Input,
    *,
    size: str | None = None,
    onto: OptionalInput = None,
    out: Path,
    is_detail: bool = False,
    crop: Region | None = None,
    method: processing.SynthesisMethod = "quilting",
    patch: Count | None = None,
    overlap: Count | None = None,
    seed: Seed = 0,
    rotate: bool = False,
    mirror: bool = False,
    tileable: bool = False,
    image_space: bool = False,
    keep_target_detail: bool = False,
    guidance: GuidanceOptions = _GUIDANCE,
    options: SeparationOptions = SEPARATION,
    green: Green = "up",
    target_green: Green = "up",
    maps: MapOptions = MAPS,
    memory: Memory | None = None,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Continue the detail of a normal map over a sheet of any size, or over a target.

    Patches of the exemplar are joined along cuts where they differ least. With --size, the result
    is a detail component, which `sgp detail combine` puts on a shape of the same size, and it is
    itself the normal map of a flat sheet. With --onto, the detail covers the mask of the target and
    follows its surface: on slopes it is foreshortened, not stretched.

    For example:

        sgp detail synthesize hide.png --size 2048x2048 --tileable --out sheet
        sgp detail synthesize hide.png --onto cat/normals --out leather-cat

    Parameters
    ----------
    exemplar
        Image of normals, or folder with normals.* and mask.png, such as a result.
    size
        Width and height of the sheet in pixels (WxH); this or --onto.
    onto
        Normal map of the target, whose shape gets the detail.
    out
        Folder for detail.exr and detail.png, mask.png, invented.png (white where a pixel was
        synthesised), synthesis.png and synthesize.json; with --onto, also normals.exr and
        normals.png, the shape of the target with the detail.
    is_detail
        The exemplar is a detail component; it is not separated again.
    crop
        Region x,y,w,h of the exemplar to use, in pixels.
    method
        With --size: quilting (patches, joined along cuts) or efros-leung (pixel by pixel, the
        reference of the paper; slow, for small sheets).
    patch
        Side of the square patches in pixels; it should exceed the largest structures. With
        efros-leung, side of the neighbourhood, odd. default: 48, with efros-leung: 11.
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
    image_space
        With --onto: the pattern follows the pixels of the image instead of arc length on the
        surface.
    keep_target_detail
        With --onto: add the detail to the target's normals instead of its shape component.
    guidance
        Maps that guide the pattern on a target.
    options
        Low-pass filter that separates the exemplar and the target.
    green
        Direction of the green channel in the exemplar.
    target_green
        Direction of the green channel in the target.
    maps
        Form of the PNG.
    memory
        Memory to use, such as 3G or 500M; default: half of what is free. A sheet that does not fit
        is synthesised in strips of rows, in files in the output folder; the same command continues
        it if it was interrupted. --onto and efros-leung need the complete maps.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    if (size is None) == (onto is None):
        raise UsageError("give either --size, for a sheet, or --onto, for a target")
    if onto is None and (image_space or keep_target_detail):
        raise UsageError("--image-space and --keep-target-detail require --onto")
    if onto is not None and tileable:
        raise UsageError("--tileable is for sheets and cannot be used with --onto")
    guidance.check(onto=onto is not None)
    if method != "quilting" and (onto or rotate or mirror or tileable or overlap is not None):
        raise UsageError(
            "--onto, --rotate, --mirror, --tileable and --overlap require --method quilting"
        )
    width, height = (0, 0) if size is None else image_size("--size", size)
    limit = Limit(memory, out / "synthesize", force)
    found = processing.find_normals(exemplar, max_pixels=max_pixels)
    of_sheet = (height, width)
    if onto is not None:
        of_sheet = processing.find_normals(onto, max_pixels=max_pixels).size
    stage = processing.synthesis.SynthesisStage(
        of_sheet, patch or 48, overlap, seed, rotate, mirror, tileable
    )
    need = stage.need(found.size)
    if onto is not None:
        need = replace(need, of=need.of.replace("sheet", "target"))
    if onto is not None or method != "quilting":
        limit.check_whole(need, "--onto" if onto is not None else f"--method {method}")
    else:
        limit.must_be_stored(need)  # refuses a limit that is too small before anything is read
    read = MapInput(exemplar, green, max_pixels=max_pixels).read()
    result = Result(warnings=list(read.warnings), inputs=[*read.files, *guidance.files()])
    shape_filter = options.shape_filter()
    window = _window(read.normal_map, crop, exemplar)
    guides = guidance.read(window, read.normal_map.size, max_pixels)
    target = None
    if onto is not None:
        second = MapInput(onto, target_green, "--target-green", max_pixels).read()
        result.warnings += second.warnings
        result.inputs += second.files
        target = second.normal_map
    detail = read.normal_map
    if not is_detail:
        detail = with_progress(processing.separate)(detail, shape_filter=shape_filter).detail
    detail = processing.NormalMap(detail.normals[window], detail.mask[window])
    if is_detail:
        result.warnings += _shape_notice(detail, shape_filter, exemplar)
    with ExitStack() as opened:
        if method != "quilting":
            sides: dict[str, Any] = {} if patch is None else {"patch": patch}
            grow = with_progress(processing.synthesis.SYNTHESIZERS[method])
            made = Synthesised.in_memory(grow(detail, of_sheet, seed=seed, **sides))
        elif target is None and limit.must_be_stored(need):
            given = {**options_of(stage), "is_detail": is_detail, "crop": crop}
            given |= {**asdict(options), "green": green}
            depends_on = identity(given, list(read.files))
            sheet = opened.enter_context(
                maps_in_files(stage, [found.size], limit, depends_on, lambda _: [detail])
            )
            made = Synthesised.of_sheet(stage, sheet)
        elif target is None:
            whole = with_progress(processing.stages.computed)(stage, detail)
            made = Synthesised.of_sheet(stage, whole)
        else:
            shape = shape_filter.shape(target)
            grown = with_progress(processing.synthesize_onto)(
                detail,
                shape,
                image_space=image_space,
                **guides,
                **{name: getattr(stage, name) for name in _PLACING},
            )
            made = Synthesised.in_memory(grown)
        claim_folder(out, "synthesize.json")
        result.outputs = maps.write(out, made.normals, made.mask, "detail")
        acquisition.write_mask(result.file("invented", out / "invented.png"), made.mask)
        metrics: dict[str, Any] = {**measure_texture(made, detail, result)}
        result.outputs["picture"] = picture = out / "synthesis.png"
        if target is None:
            write_sheet_picture(picture, f"Synthesis from {exemplar.name}", made, detail)
        elif onto is not None:
            normals = processing.combine(target if keep_target_detail else shape, grown.detail)
            result.outputs |= maps.write_map(out, normals)
            metrics |= measure_transfer(grown, shape, normals, shape_filter, result)
            title = f"Detail of {exemplar.name} on {onto.name}"
            write_target_picture(picture, title, detail, target, normals)
    result.metrics = metrics
    return result


def _window(
    detail: processing.NormalMap, crop: tuple[int, int, int, int] | None, path: Path
) -> tuple[slice, slice]:
    """Return the part of the exemplar to use."""
    rows, columns = detail.size
    if crop is None:
        return slice(0, rows), slice(0, columns)
    x, y, width, height = crop
    if min(x, y) < 0 or min(width, height) < 1 or x + width > columns or y + height > rows:
        raise UsageError(
            f"--crop {x},{y},{width},{height} leaves the {columns} x {rows} pixels of {path}: give "
            "x,y,w,h inside"
        )
    window = slice(y, y + height), slice(x, x + width)
    if not detail.mask[window].any():
        raise UsageError(f"--crop {x},{y},{width},{height}: no normal of {path} is inside")
    return window


def _shape_notice(
    detail: processing.NormalMap, shape_filter: processing.ShapeFilter, path: Path
) -> list[rig.Notice]:
    """Return a notice if a map that was given as a detail component contains shape."""
    if min(detail.size) <= 2 * shape_filter.w:
        return []  # too small to separate; the synthesis decides whether a patch fits
    z = np.array([0, 0, 1], np.float32)
    shape = shape_filter.shape(detail).normals[detail.mask]
    left = float(np.mean(acquisition.angle_deg(shape, z), dtype=np.float64))
    whole = float(np.mean(acquisition.angle_deg(detail.normals[detail.mask], z), dtype=np.float64))
    if left <= _MOST_SHAPE * whole:
        return []
    text = (
        f"the exemplar contains shape: its low-pass part is tilted by {left:.1f} degrees on "
        f"average (separability), the map itself by {whole:.1f}; omit --is-detail to separate it"
    )
    return [rig.Notice("exemplar-with-shape", text, str(path))]
