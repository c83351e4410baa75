"""Normal maps that have the normals at the centres of pixels, not the means over their area."""

from __future__ import annotations

import processing
import rig
from sgp._record import records_of

_PROJECT = "sgp project"


def points_notices(read: processing.NormalMapFile) -> list[rig.Notice]:
    """Name a map that has the normals at the centres of pixels, by the record next to it.

    The normals alone do not show it: means over pixels look like points of a smoother surface.
    """
    text = (
        f"{_PROJECT} draws the normals at the centres of the pixels: they are averaged over the "
        "pixels first"
    )
    for file in read.files:
        if any(record.command == _PROJECT for _, record in records_of(file)):
            return [rig.Notice("superres-points", text, str(file), "info")]
    return []
