"""What a tethered camera is watched for: the shots, their names, and their lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from acquisition._plan.plan import CapturePlan
from acquisition._plan.planned_shot import PlannedShot
from acquisition._values.lights import Lights, led_id
from rig import MAX_PIXELS


@dataclass(frozen=True)
class Watch:
    """What to watch for.

    Parameters
    ----------
    folder
        Where the camera's images appear. Names that begin with a dot are ignored, and where there
        is camera RAW everything else is.
    shots
        The shots in the order in which they are taken: `CapturePlan.shots`, or `lights_in_order`.
    plan
        The plan they come from, if any; it is stored in the session.
    interval_s
        Seconds between shots; default: found from the first images.
    gaps
        False where pauses mean nothing: images are matched by order alone.
    timeout_s
        How long to wait for the next image.
    settle_s
        How long a file must stay as it is to count as whole.
    max_pixels
        The most that an image may have.
    """

    folder: Path
    shots: tuple[PlannedShot, ...]
    plan: CapturePlan | None = None
    interval_s: float | None = None
    gaps: bool = True
    timeout_s: float = 600.0
    settle_s: float = 1.0
    max_pixels: int = MAX_PIXELS


def lights_in_order(leds: int) -> tuple[PlannedShot, ...]:
    """Return one shot of each LED from 0, of unknown exposure."""
    return tuple(PlannedShot("light", led, 0, 0, None) for led in range(leds))


def shot_files(shots: Sequence[PlannedShot]) -> list[str]:
    """Return the names of the shots' files."""
    return [shot.file for shot in shots]


def shots_by_name(shots: Sequence[PlannedShot]) -> dict[str, int]:
    """Return the shots by the names of files meant for them: ``l07_e0``, or ``l07`` for its first.

    In lower case, without a suffix.
    """
    names: dict[str, int] = {}
    for index, shot in enumerate(shots):
        names[Path(shot.file).stem.casefold()] = index
        if shot.led is not None:
            names.setdefault(led_id(shot.led).casefold(), index)
    return names


def lights_of_shots(shots: Sequence[PlannedShot], lights: Lights | None) -> Lights | None:
    """Return the lights of the shots' LEDs, under the LEDs' names."""
    if lights is None:
        return None
    ids = list(dict.fromkeys(led_id(shot.led) for shot in shots if shot.led is not None))
    indices, _ = lights.match(ids)
    return replace(lights.take(indices), ids=tuple(ids))
