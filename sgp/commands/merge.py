"""``sgp merge``: join overlapping fields of one object."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from rig.arrays import Bool
from sgp.batch import batch_folder
from sgp.cli.console import with_progress
from sgp.cli.exit import UsageError
from sgp.cli.options import Inputs, Memory, OptionalInput, Pixels, distinct
from sgp.commands.batch import batch
from sgp.results import (
    FieldMetrics,
    FieldPairMetrics,
    MergeMetrics,
    Result,
    claim_folder,
    median_of,
    writes_folder,
)
from sgp.stages import (
    MAPS,
    FieldResult,
    Limit,
    MapOptions,
    has_normals,
    identity,
    maps_in_files,
    open_fields,
)

# Above these, the fields fit worse than they should: pixels, and standard deviations.
_MISPLACED_PX, _DISAGREEMENT = 0.3, 2.0


@writes_folder("merge.json")
def merge(
    fields: Inputs,
    *,
    out: Path,
    recipe: OptionalInput = None,
    maps: MapOptions = MAPS,
    memory: Memory | None = None,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Join overlapping fields of one object into one.

    Recordings are processed first, as by sgp batch, in a folder next to the result; what is done
    there is not computed again.

    For example:

        sgp merge left/ middle/ right/ --out whole
        sgp merge sessions/* --recipe recipe.toml --out whole

    Parameters
    ----------
    fields
        Folders that sgp normals or sgp run has written, or recordings, in any order: fields of the
        same scale that are moved and turned in the plane, and overlap by about 15 %. The whole has
        the axes of the first.
    out
        Folder for normals.exr, normals.png, normal_sigma_deg.exr, albedo.exr, albedo.png,
        fields.png (number of fields that show a pixel), merge.png, mask.png and merge.json with the
        place of each field and what is left between them.
    recipe
        Recipe of sgp batch (.toml) for fields that are recordings; their results are in the folder
        OUT-fields.
    maps
        Form of the PNG.
    memory
        Memory to use, such as 3G or 500M; default: half of what is free. Maps that do not fit are
        computed in bands of rows, in files in the output folder; the same command continues them
        if it was interrupted.
    max_pixels
        Refuse images, and a whole, with more pixels than this.
    force
        Write into an output folder that already contains files.
    """
    distinct(fields)
    results = _processed(fields, out.with_name(f"{out.name}-fields"), recipe)
    with ExitStack() as opened:
        given = open_fields(results, max_pixels, opened)
        rows = tuple(field.rows for field in given)
        placements = with_progress(processing.merging.place_fields)(rows)
        stage = processing.merging.FusionStage(rows, placements)
        height, width = placements.size
        if height * width > max_pixels:
            raise acquisition.DataError(
                f"the whole has {width} x {height} pixels, more than {max_pixels}: give "
                "--max-pixels, or fewer fields"
            )
        limit = Limit(memory, out / "merge", force)
        files = [file for field in given for file in field.files]
        with _fused(stage, limit, files) as fused:
            folder = claim_folder(out, "merge.json", files)
            result = _written(folder, fused, given, stage, maps)
    result.inputs = files
    return result


def _processed(fields: Sequence[Path], folder: Path, recipe: Path | None) -> list[Path]:
    """Return the results of all fields, after recordings among them were processed in a folder."""
    recordings = tuple(one for one in fields if not has_normals(one))
    if not recordings:
        if recipe is not None:
            raise UsageError(f"{recipe}: all fields are results already: leave the recipe out")
        return list(fields)
    batch(recordings, out=folder, recipe=recipe)
    with batch_folder(folder) as states:
        known = {state.source: (name, state.error) for name, state in states.read_all().items()}
    results = []
    for one in fields:
        if one not in recordings:
            results.append(one)
            continue
        name, error = known[str(one.resolve())]
        if error is not None:
            log = folder / "state" / f"{name}.log"
            raise acquisition.DataError(f"{one} cannot be processed: {error} (log: {log})")
        results.append(folder / name)
    return results


@contextmanager
def _fused(
    stage: processing.merging.FusionStage, limit: Limit, files: list[Path]
) -> Iterator[acquisition.files.Maps]:
    """Provide the maps of the whole, in memory or in files."""
    if limit.must_be_stored(stage.need()):
        with maps_in_files(stage, (), limit, identity({}, files), lambda _: ()) as store:
            yield store
    else:
        yield with_progress(processing.stages.computed)(stage)


def _written(
    folder: Path,
    fused: acquisition.files.Maps,
    given: Sequence[FieldResult],
    stage: processing.merging.FusionStage,
    maps: MapOptions,
) -> Result:
    """Write the maps; return files and figures."""
    from sgp.pictures import Crop, Masked, map_panel, normals_panel, write_overview

    counts = fused["fields"]
    mask, several = _mask_of(counts)
    result = Result(outputs=maps.write(folder, fused["normals"], mask))
    names = ["normal_sigma_deg", *(["albedo"] if stage.channels else [])]
    for name in names:
        acquisition.write_exr(result.file(name, folder / f"{name}.exr"), fused[name])
    if stage.channels:
        white = processing.colour.albedo_white(fused["albedo"], mask)
        result.parameters = {"albedo_png": {"white": white}}
        samples = acquisition.files.ComputedRows(
            fused["albedo"].shape,
            np.dtype(np.uint8),
            lambda rows: processing.colour.albedo_samples(fused["albedo"][rows], mask[rows], white),
        )
        picture = result.file("albedo_png", folder / "albedo.png")
        description = f"albedo / {white:.6g} as sRGB"
        acquisition.write_png(picture, samples, srgb=True, description=description)
    acquisition.write_png(result.file("fields", folder / "fields.png"), counts)
    metrics = _metrics(given, stage.placements, mask, several, fused["normal_sigma_deg"])
    result.metrics = metrics
    result.warnings = _notices(given, stage.placements)
    crop = Crop.around(mask)
    panels = [
        normals_panel("normals", Masked(fused["normals"], mask), crop),
        map_panel("number of fields", counts, "", crop, mask=mask),
    ]
    if metrics["normal_sigma_deg"] is not None:
        sigma = fused["normal_sigma_deg"]
        panels.append(map_panel("standard deviation", sigma, "deg", crop, error=True))
    title = f"{len(given)} fields, which fit to {rig.figure(metrics['residual_px'])} px"
    write_overview(result.file("picture", folder / "merge.png"), title, panels)
    height, width = mask.shape
    result.summary = [
        f"{len(given)} fields in {width} x {height} pixels, {metrics['overlap']:.0%} seen several "
        "times",
        f"{rig.pluralize(len(stage.placements.pairs), 'pair')} of fields fit to "
        f"{rig.figure(metrics['residual_px'])} px rms",
    ]
    if metrics["normal_sigma_deg"] is not None:
        result.summary.append(
            f"standard deviation of normals {rig.figure(metrics['normal_sigma_deg'])} deg (median)"
        )
    return result


def _mask_of(counts: acquisition.MapRows) -> tuple[Bool, int]:
    """Return the pixels that a field shows, and the number that several show."""
    height, width = counts.shape
    mask, several = np.zeros((height, width), bool), 0
    for rows in acquisition.files.rows_in_bands(height, width, 4_000_000):
        part = counts[rows]
        mask[rows] = part > 0
        several += int(np.count_nonzero(part > 1))
    return mask, several


def _metrics(
    given: Sequence[FieldResult],
    placements: processing.merging.Placements,
    mask: Bool,
    several: int,
    sigma_deg: acquisition.MapRows,
) -> MergeMetrics:
    pixels = int(np.count_nonzero(mask))
    weightless = any(field.rows.sigma_deg is None for field in given)
    names = [field.rows.name for field in given]
    fields: list[FieldMetrics] = []
    for number, field in enumerate(given):
        height, width = field.rows.size
        column, row, _ = placements.matrices[number] @ [(width - 1) / 2, (height - 1) / 2, 1]
        fields.append(
            {
                "field": names[number],
                "column_px": float(column),
                "row_px": float(row),
                "turn_deg": float(placements.turns_deg[number]),
                "tilt_deg": float(np.degrees(np.linalg.norm(placements.tilts[number]))),
                "albedo_gain": float(placements.gains[number]),
            }
        )
    metrics: MergeMetrics = {
        "pixels": pixels,
        "overlap": several / pixels,
        "residual_px": placements.residual_px,
        "fields": fields,
        "pairs": _pairs(names, placements),
        "normal_sigma_deg": None if weightless else median_of(sigma_deg),
        "normal_sigma_common_deg": max(field.rows.common_sigma_deg for field in given),
    }
    scales = [field.pixel_mm for field in given if field.pixel_mm is not None]
    if scales:
        metrics["pixel_mm"] = float(np.median(scales))
    return metrics


def _pairs(
    names: Sequence[str], placements: processing.merging.Placements
) -> list[FieldPairMetrics]:
    pairs: list[FieldPairMetrics] = [
        {
            "first": names[pair.first],
            "second": names[pair.second],
            "used": number < len(placements.pairs),
            "common_px": pair.common_px,
            "correlation": pair.correlation,
        }
        for number, pair in enumerate((*placements.pairs, *placements.rejected))
    ]
    for number, residual_px in enumerate(placements.residuals_px):
        pairs[number]["residual_px"] = residual_px
        pairs[number]["deviations"] = placements.deviations[number]
        pairs[number]["disagreement"] = placements.disagreements[number]
    return pairs


def _notices(
    given: Sequence[FieldResult], placements: processing.merging.Placements
) -> list[rig.Notice]:
    names, notices = [field.rows.name for field in given], []
    for pair in placements.rejected:
        text = (
            f"{names[pair.first]} and {names[pair.second]} look alike at a place that contradicts "
            "the other fields: their overlap was not used"
        )
        notices.append(rig.Notice("fields-contradict", text))
    if placements.residual_px > _MISPLACED_PX:
        text = (
            f"the fields fit to {placements.residual_px:.2f} px only: the lens distorts, the "
            "object is high, or it changed its shape"
        )
        notices.append(rig.Notice("fields-misplaced", text))
    differences = [one for one in placements.disagreements if np.isfinite(one)]
    usual = float(np.median(differences)) if differences else 0.0
    if usual > _DISAGREEMENT:
        text = (
            f"normals of overlapping fields differ by {usual:.1f} times their standard deviations: "
            "lights or images have errors that these do not include"
        )
        notices.append(rig.Notice("fields-disagree", text))
    without = [field.rows.name for field in given if field.rows.sigma_deg is None]
    if without:
        text = (
            f"{', '.join(without)}: standard deviations of the normals are not known, so that all "
            "fields count equally"
        )
        notices.append(rig.Notice("fields-without-sigma", text))
    return notices
