"""Normal maps that have the normals at the centres of pixels, not the means over their area."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import rig
from sgp._record import records_of

_PROJECT = "sgp project"


def points_notices(files: Sequence[Path]) -> list[rig.Notice]:
    """Name a map that has the normals at the centres of pixels, by the record next to it.

    The normals alone do not show it: means over pixels look like points of a smoother surface. A
    map without a record is named, too.
    """
    commands = {record.command for file in files for _, record in records_of(file)}
    where = str(files[0])
    if _PROJECT in commands:
        text = (
            f"{_PROJECT} draws the normals at the centres of the pixels: they are averaged over "
            "the pixels first"
        )
        return [rig.Notice("superres-points", text, where, "info")]
    if not commands:
        text = (
            "no record says what the normals are: they count as means over pixels, as a camera "
            "records them; for a rendering or a projection, give --sampling points"
        )
        return [rig.Notice("superres-means-assumed", text, where, "info")]
    return []
