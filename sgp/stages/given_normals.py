"""How to read a normal map that is a surface only with other axes."""

from __future__ import annotations

from dataclasses import replace

import rig
from sgp.cli.options import Green


def with_remedy(notice: rig.Notice, green: Green, option: str | None = "--green") -> rig.Notice:
    """Name the option that inverts green, if it may help."""
    if notice.code != "normals-mirrored" or option is None:
        return notice
    other = "down" if green == "up" else "up"
    return replace(notice, text=f"{notice.text}; if green is the other way round, {option} {other}")
