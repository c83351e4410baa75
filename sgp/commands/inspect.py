"""``sgp inspect``: test whether images, lights and normals agree."""

from __future__ import annotations

import math

from sgp.cli.options import Input, RecordingOptions, SourceOptions
from sgp.results import InspectMetrics, Result, add_quality, quality_lines
from sgp.stages import compute_normals, open_recording

_DEFAULTS = RecordingOptions()


def inspect(source: Input, *, options: RecordingOptions = _DEFAULTS) -> Result:
    """Test whether the images, lights and normals of a recording agree; write nothing.

    A warning names the likely cause if they do not: lights in another order, swapped or turned
    images, a lamp that moved, mirrored axes, a wrong transfer curve. docs/quality.md states the
    limits. Warnings do not change the exit code.

    For example:

        sgp inspect photographs/ --lights lights.json

    Parameters
    ----------
    source
        Session, DiLiGenT object folder, images with an .lp file, or folder of images.
    options
        Lights, camera, mask and parts of the recording.
    """
    opened = open_recording(source, options)
    # The tests compute the normals that they need: the quicker method is enough.
    stage = compute_normals(opened.source, SourceOptions(**vars(options), method="ls").stage())
    metrics: InspectMetrics = {
        "images": len(stage.lights),
        "lights": "near" if stage.lights.near else "distant",
        "pixels": int(stage.mask.sum()),
    }
    add_quality(metrics, stage.quality)
    doubts = [notice for notice in stage.warnings if notice.code == "transfer-curve-doubtful"]
    if doubts or stage.quality.warnings:
        verdict = "images, lights and normals do not agree"
    elif math.isnan(stage.quality.curl) and all(map(math.isnan, stage.quality.light_error_deg)):
        verdict = "too little data: neither lights nor normals could be tested"
    else:
        verdict = "no disagreement found"
    return Result(
        metrics=metrics,
        warnings=[*(opened.lit_by.warnings if opened.lit_by else ()), *stage.warnings],
        summary=[
            f"{metrics['images']} images, {metrics['lights']} lights, {metrics['pixels']} pixels",
            *quality_lines(stage.quality),
            verdict,
        ],
    )
