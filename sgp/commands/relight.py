"""``sgp relight``: a polynomial texture map under a light."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from sgp.cli.exit import UsageError
from sgp.cli.options import Input, Pixels, numbers
from sgp.results import RelightMetrics, Result, check_file


def relight(
    ptm: Input, *, light: str, out: Path, max_pixels: Pixels = rig.MAX_PIXELS, force: bool = False
) -> Result:
    """Write a polynomial texture map (.ptm) as it looks under a light.

    For example:

        sgp relight rti/relight.ptm --light 0,1,0.5 --out from-above.png

    Parameters
    ----------
    ptm
        File of the kind PTM_FORMAT_LRGB or PTM_FORMAT_RGB, of sgp export or another program.
    light
        Direction toward the light: x (right), y (up), z (toward the camera), of any length.
    out
        PNG to write.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Overwrite an existing file.
    """
    direction = numbers("--light", light, 3)
    length = math.hypot(*direction)
    if not 0 < length < math.inf or direction[2] < 0:
        raise UsageError(
            f"--light {light}: give a direction with a length, toward the camera (z at least 0)"
        )
    unit = [x / length for x in direction]
    check_file(out, ".png", force=force)
    image = processing.relight.read_ptm(ptm, max_pixels=max_pixels)
    shown = np.rint(255 * np.clip(image.relit(unit), 0, 1)).astype(np.uint8)
    acquisition.write_png(out, shown, srgb=True)
    height, width = image.size
    metrics: RelightMetrics = {
        "width": width,
        "height": height,
        "colours": "rgb" if image.colour is None else "lrgb",
        "direction": unit,
    }
    x, y, z = unit
    return Result(
        outputs={"image": out},
        metrics=metrics,
        inputs=[ptm],
        summary=[
            f"{out}: {width} x {height} pixels, {metrics['colours'].upper()}, light from "
            f"({x:.2f}, {y:.2f}, {z:.2f})"
        ],
    )
