"""``sgp detail transfer``: transfer detail from one map to another, globally or locally."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import acquisition
import processing
import rig
from rig.arrays import Bool
from sgp.cli import options
from sgp.cli.console import Stages, with_progress
from sgp.cli.exit import UsageError
from sgp.results import Result, claim_folder, writes_folder
from sgp.stages import (
    MAPS,
    Limit,
    MapInput,
    MapOptions,
    Transferred,
    stage_maps,
    write_height_profile,
)
from sgp.stages.write_transfer import write_transfer

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

    source_mask: options.OptionalInput = None
    target_mask: options.OptionalInput = None
    scale: options.Positive = 1.0
    rotate_deg: options.Degrees = 0.0
    mirror: bool = False

    def given(self) -> list[str]:
        """Return the options that differ from their defaults."""
        return [
            f"--{field.name.replace('_', '-')}"
            for field in fields(self)
            if getattr(self, field.name) != field.default
        ]

    def masks(self) -> list[Path]:
        """Return the files of the masks."""
        return [path for path in (self.source_mask, self.target_mask) if path is not None]


@writes_folder("normals.json")
def transfer(
    source: options.Input,
    target: options.Input,
    *,
    out: Path,
    keep_target_detail: bool = False,
    amplitude: options.Factor = 1.0,
    refine: options.Steps = 0,
    filter: processing.detail.FilterKind = "gaussian",  # noqa: A002
    order: options.Order = 8,
    w: options.Count | None = None,
    at: Place | None = None,
    tile: processing.Tile = "cut",
    local: LocalOptions = LocalOptions(),
    profile: bool = False,
    source_green: options.Green = "up",
    target_green: options.Green = "up",
    written: MapOptions = MAPS,
    memory: options.Memory | None = None,
    max_pixels: options.Pixels = rig.MAX_PIXELS,
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
    memory
        Memory to use, such as 3G or 500M; default: half of what is free. Maps that do not fit are
        computed in bands of rows, in files in the output folder; the same command continues them
        if it was interrupted. A local transfer and --profile need the complete maps.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    place = None if at is None else options.numbers("--at", at, 2)
    is_local = local != LocalOptions()
    if is_local and (keep_target_detail or refine):
        raise UsageError("--keep-target-detail and --refine cannot be used in a local transfer")
    if tile != "cut" and (is_local or place is not None):
        raise UsageError(
            "--tile cannot be used with --at or in a local transfer: only one copy is placed"
        )
    limit = Limit(memory, out / "normals", force)
    maps = (
        MapInput(source, source_green, "--source-green", max_pixels),
        MapInput(target, target_green, "--target-green", max_pixels),
    )
    by = processing.ShapeFilter(filter, order, (10 if is_local else 5) if w is None else w)
    where = None if is_local or place is None else _whole(place)
    stage = processing.detail.TransferStage(keep_target_detail, amplitude, refine, by, where, tile)
    whole = [*local.given(), *(["--profile"] if profile else [])]
    read = None
    if whole:
        limit.check_whole(stage.need(*(one.find().size for one in maps)), whole[0])
        read = [one.read() for one in maps]
    with ExitStack() as opened:
        if read is not None and is_local:
            done = _transfer_local(read[0], read[1], local, place, amplitude, by)
        else:
            made = opened.enter_context(stage_maps(stage, maps, limit, read=read))
            done = Transferred.of_stage(stage, made)
        result = Result(warnings=[*done.warnings], inputs=[*done.files, *local.masks()])
        claim_folder(out, "normals.json")
        result.outputs = written.write(out, done.normals, done.mask)
        title = f"Detail of {source.name} on {target.name}"
        metrics = write_transfer(out, title, done, result)
        if profile and read is not None:
            transferred = processing.NormalMap(done.normals[:], done.mask)
            profiled = write_height_profile(out, read[1].normal_map, transferred, result)
            metrics = {**metrics, **profiled}
    result.metrics = metrics
    return result


def _transfer_local(
    source: processing.NormalMapFile,
    target: processing.NormalMapFile,
    local: LocalOptions,
    place: list[float] | None,
    amplitude: float,
    shape_filter: processing.ShapeFilter,
) -> Transferred:
    done = with_progress(processing.transfer_local)(
        source.normal_map,
        target.normal_map,
        source_mask=_mask(local.source_mask, source.normal_map),
        target_mask=_mask(local.target_mask, target.normal_map),
        pose=processing.detail.Pose(
            None if place is None else (place[0], place[1]),
            local.scale,
            local.rotate_deg,
            local.mirror,
        ),
        amplitude=amplitude,
        shape_filter=shape_filter,
    )
    with Stages() as progress:
        return Transferred.of_part(done, source, target, progress)


def _mask(path: Path | None, normal_map: processing.NormalMap) -> Bool | None:
    return None if path is None else acquisition.read_mask(path, normal_map.size)


def _whole(place: list[float]) -> tuple[int, int]:
    if not all(value.is_integer() for value in place):
        raise UsageError("--at must be whole pixels, except in a local transfer")
    return int(place[0]), int(place[1])
