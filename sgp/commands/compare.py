"""``sgp compare``: the difference between two normal maps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from processing.changes import find_changes
from processing.registration import register_fields
from sgp.cli.exit import UsageError
from sgp.cli.options import Green, Input, OptionalInput, Pixels, Positive, Probability
from sgp.results import CompareMetrics, Result, claim_folder, figures_of, writes_folder
from sgp.stages import MapInput, add_changes, add_difference, read_field

# Share by which a camera's distance changes its scale within one set-up.
_SCALES_AGREE = 0.01


@writes_folder("compare.json")
def compare(
    a: Input,
    b: Input,
    *,
    mask: OptionalInput = None,
    register: bool = False,
    significance: bool = False,
    false_alarm: Probability = 0.05,
    pixel_mm: Positive | None = None,
    green: Green = "up",
    green_b: Green | None = None,
    out: Path | None = None,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Compare two normal maps: angular error, SSIM, error map.

    All pixels of the mask count; a pixel without a normal in A counts as an error of 90 degrees.
    With --register, A and B are results of the same object before and after, which may have been
    moved and turned in between; --significance finds what has changed.

    For example:

        sgp compare out/normals truth.exr --mask mask.png --out comparison
        sgp compare 2025 2026 --register --significance --out changes

    Parameters
    ----------
    a
        Map to evaluate: image of normals, or folder with normals.* and mask.png, such as a result.
    b
        Reference map.
    mask
        Mask image of the pixels that count; default: all pixels with a normal in B. With
        --register, of A.
    register
        Find where the pixels of A are in B, and show the differences B - A.
    significance
        With --register, find the differences that are no errors, with the smallest change that
        would have been found.
    false_alarm
        Probability that --significance finds anything on the complete map if nothing has changed.
    pixel_mm
        Size of a pixel of A and B on the object in mm; default: that of the recordings.
    green
        Direction of the green channel of A, and of B without --green-b.
    green_b
        Direction of the green channel of B.
    out
        Folder for error.exr, error.png and compare.json; without it, nothing is written. With
        --register, for normals_deg.exr, albedo_factor.exr, difference.png and the normals of B on
        the pixels of A instead; with --significance also for changes.csv, changes.png,
        significant.png and the maps change_*.exr.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    inputs = (
        MapInput(a, green, max_pixels=max_pixels),
        MapInput(b, green_b or green, "--green-b", max_pixels),
    )
    if register:
        wanted = false_alarm if significance else None
        return _registered(inputs, mask=mask, false_alarm=wanted, pixel_mm=pixel_mm, out=out)
    if significance or pixel_mm is not None:
        option = "--significance" if significance else "--pixel-mm"
        raise UsageError(f"{option} compares registered maps: give --register as well")
    first, second = (given.read() for given in inputs)
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


def _registered(
    inputs: tuple[MapInput, MapInput],
    *,
    mask: Path | None,
    false_alarm: float | None,
    pixel_mm: float | None,
    out: Path | None,
) -> Result:
    """Compare a field before and after; ``false_alarm`` is None without significance."""
    if false_alarm is not None and out is None:
        raise UsageError("--significance writes maps and a table: give --out")
    a, b = (given.path for given in inputs)
    before, after = (read_field(given, pixel_mm) for given in inputs)
    result = Result(
        warnings=[*before.notices, *after.notices],
        inputs=[*before.files, *after.files, *([] if mask is None else [mask])],
    )
    first = before.field
    if mask is not None:
        inside = acquisition.read_mask(mask, first.mask.shape) & first.mask
        vectors = processing.NormalMap.from_vectors(first.normal_map.normals, inside)
        first = replace(first, normal_map=vectors)
    for path, one in ((a, before), (b, after)):
        if false_alarm is not None and one.field.sigma_deg is None:
            raise acquisition.DataError(
                f"{path}: has no normal_sigma_deg.exr, so the significance of changes is not "
                "known: compute the normals with `sgp normals` from 5 images at least, or leave "
                "--significance out"
            )
    if false_alarm is not None and before.images & after.images:
        raise acquisition.DataError(
            f"{a} and {b}: were computed from the same images, so their errors are the same: the "
            "significance of changes needs two recordings"
        )
    scales = before.pixel_mm, after.pixel_mm
    if (scales[0] is None) != (scales[1] is None):
        unknown = a if scales[0] is None else b
        raise acquisition.DataError(
            f"{unknown}: its scale is not known, but that of the other map is: give --pixel-mm"
        )
    registration = register_fields(first, after.field, model="homography")
    if scales[0] is not None and scales[1] is not None:
        stated, seen = scales[0] / scales[1], registration.enlargement
        if abs(seen / stated - 1) > _SCALES_AGREE:
            text = (
                f"AFTER shows the object {seen:.3f} times as large as BEFORE, but their pixel "
                f"sizes state {stated:.3f}: one of the two is wrong, and so are heights in mm"
            )
            result.warnings.append(rig.Notice("scales-contradict", text))
    there = registration.resampled(after.field)
    if out is not None:
        claim_folder(out, "compare.json")
    found = None
    if false_alarm is not None:
        blurs = [one.blur_px for one in (before, after) if one.blur_px is not None]
        blur = {"blur_px": max(blurs)} if blurs else {}
        found = find_changes(first, there, registration.common, false_alarm=false_alarm, **blur)
    metrics = add_difference(result, first, there, registration, scales[0], out)
    if found is not None and out is not None:
        add_changes(result, metrics, found, scales[0], out)
    result.metrics = metrics
    lost = np.count_nonzero(registration.common & ~registration.holds)
    if lost:
        text = (
            f"the fine structure of {lost / np.count_nonzero(registration.common):.1%} of the "
            "common area differs: it has changed there, or the registration does not hold"
        )
        result.warnings.append(rig.Notice("registration-doubtful", text))
    return result


def distinct_names(a: Path, b: Path) -> tuple[str, str]:
    """Return the ends of two paths, long enough to differ; the names if the paths are the same."""
    parts = a.absolute().parts, b.absolute().parts
    for count in range(1, 1 + max(map(len, parts))):
        ends = tuple(str(Path(*path[-count:])) for path in parts)
        if ends[0] != ends[1]:
            return ends[0], ends[1]
    return a.name, b.name
