"""When and with what lights were calibrated, recorded with the lights."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime

from acquisition import Calibrated, Source, UsedSphere, source_setup
from calibration._spheres.sphere_calibration import SphereCalibration
from rig import check_type


def record_setup(estimate: SphereCalibration, source: Source, *others: Source) -> SphereCalibration:
    """Return a calibration whose lights state time, rig, camera, lens and spheres.

    The time is the start of the (first) recording, or now if the recording does not state it. Only
    sessions of a rig know their rig. `write_lights` writes all of it to lights.json, and
    `acquisition.setup_notices` compares it with a recording.

    Parameters
    ----------
    estimate
        Result of `calibrate_spheres` or `calibrate_moved_spheres`.
    source
        The recording that shows the spheres.
    others
        Further recordings with the balls elsewhere, in the order in which they were calibrated.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from calibration import calibrate_spheres, record_setup
    >>> from simulator import render, scene_named
    >>> rendering = render(scene_named("spheres", width=160, height=128, leds=3))
    >>> write_png("L00.png", np.rint(9e3 * rendering.planes[0]).astype(np.uint16))
    >>> masks = list(rendering.truth.sphere_masks)
    >>> estimate = calibrate_spheres(rendering.planes, masks=masks)
    >>> len(record_setup(estimate, read_source("L00.png")).lights.calibrated.spheres)
    4
    """
    check_type("estimate", estimate, SphereCalibration, "calibrate_spheres(stack) returns one")
    sources = (source, *others)
    spheres = tuple(
        UsedSphere(
            sphere.outline.centre_px,
            math.sqrt(math.prod(sphere.outline.semi_axes_px)),
            sphere.centre_mm,
            sphere.radius_mm,
            str(sources[sphere.recording].path) if others else "",
        )
        for sphere in estimate.spheres
    )
    time = source.recorded_utc or datetime.now(UTC).replace(microsecond=0)
    calibrated = Calibrated(time, source_setup(source), spheres)
    return replace(estimate, lights=replace(estimate.lights, calibrated=calibrated))
