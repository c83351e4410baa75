"""``sgp inspect``: test whether images, lights and normals agree."""

from __future__ import annotations

from sgp.cli.options import Input, Positive, RemedyOptions, SourceOptions
from sgp.results import InspectMetrics, Result, add_quality, good_result, quality_lines
from sgp.stages import compute_normals, open_recording, with_scale

_DEFAULTS = RemedyOptions()


def inspect(
    source: Input,
    *,
    options: RemedyOptions = _DEFAULTS,
    pixel_mm: Positive | None = None,
    strict: bool = False,
) -> Result:
    """Test whether the images, lights and normals of a recording agree; write nothing.

    A warning names the likely cause if they do not: lights in another order, swapped or turned
    images, a lamp that moved, mirrored axes, a wrong transfer curve. docs/quality.md states the
    limits. The last line is the verdict: good, check, or do not use.

    For example:

        sgp inspect photographs/ --lights lights.json

    Parameters
    ----------
    source
        Session, DiLiGenT object folder, images with an .lp file, or folder of images.
    options
        Lights, camera, mask and parts of the recording.
    pixel_mm
        Size of a pixel on the object in mm, as for `sgp normals`.
    strict
        End with exit code 6 if the verdict is "do not use".
    """
    opened = open_recording(source, options)
    # With the method of `sgp normals`: the verdict depends on its standard deviations.
    seen, pixel = with_scale(opened.source, opened.pixel_mm(pixel_mm))
    stage = compute_normals(seen, SourceOptions(**vars(options)).stage(pixel))
    metrics: InspectMetrics = {
        "images": len(stage.lights),
        "lights": "near" if stage.lights.near else "distant",
        "pixels": int(stage.mask.sum()),
    }
    add_quality(metrics, stage.quality)
    result = Result(
        metrics=metrics,
        warnings=[*(opened.lit_by.warnings if opened.lit_by else ()), *stage.warnings],
        summary=[
            f"{metrics['images']} images, {metrics['lights']} lights, {metrics['pixels']} pixels",
            *quality_lines(stage.quality),
        ],
        verdict=stage.verdict,
        good=good_result(stage.verdict),
    )
    if strict:
        result.refuse_unusable()
    return result
