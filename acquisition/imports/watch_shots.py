"""Shots that a tethered camera is expected to take, with their file names and lights."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from acquisition.plan.plan import CapturePlan
from acquisition.plan.planned_shot import PlannedShot
from acquisition.values.lights import Lights, led_id
from acquisition.values.transfer_curve import TransferCurve
from rig import MAX_PIXELS, short_repr


@dataclass(frozen=True)
class Watch:
    """Folder and shots of a tethered capture, and how images are matched to shots.

    Parameters
    ----------
    folder
        Folder in which the camera's images appear. Names that begin with a dot are ignored. Of a
        camera that stores each exposure as RAW and as JPEG, the RAW files count.
    shots
        Shots in the order in which they are taken: `CapturePlan.shots`, or `lights_in_order`.
    plan
        Plan of the shots, if any; it is stored in the session.
    interval_s
        Seconds between shots: a longer time between two images of the same watch counts as missing
        images. None if times have no meaning.
    gaps
        False if numbers have no meaning either: images are counted in order of arrival.
    timeout_s
        Longest time to wait for the next image, seconds.
    settle_s
        Time for which a file must stay unchanged to count as complete, seconds.
    pair_s
        Time for which the first JPEGs wait for a camera RAW file, seconds. If none appears, the
        session holds JPEGs.
    max_pixels
        Largest allowed number of pixels per image.
    transfer
        Transfer curve of the images; default: as `read_source` chooses for the first image.
    """

    folder: Path
    shots: tuple[PlannedShot, ...]
    plan: CapturePlan | None = None
    interval_s: float | None = None
    gaps: bool = True
    timeout_s: float = 600.0
    settle_s: float = 1.0
    pair_s: float = 10.0
    max_pixels: int = MAX_PIXELS
    transfer: TransferCurve | None = None

    __repr__ = short_repr


def lights_in_order(leds: int | Iterable[int]) -> tuple[PlannedShot, ...]:
    """Return one shot with unknown exposure for each LED: of so many from 0, or of those listed.

    Examples
    --------
    >>> from acquisition.imports import lights_in_order
    >>> [shot.file for shot in lights_in_order([4, 2])]
    ['L04_E0.tif', 'L02_E0.tif']
    """
    numbers = range(leds) if isinstance(leds, int) else leds
    return tuple(PlannedShot("light", led, 0, 0, None) for led in numbers)


def shots_by_name(shots: Sequence[PlannedShot]) -> dict[str, int]:
    """Return the index of each shot by the file names that select it.

    Names are in lower case without a suffix: ``l07_e0`` for each shot, and ``l07`` for the first
    shot of LED 7.
    """
    names: dict[str, int] = {}
    for index, shot in enumerate(shots):
        names[Path(shot.file).stem.casefold()] = index
        if shot.role == "light" and shot.led is not None:
            names.setdefault(led_id(shot.led).casefold(), index)
    return names


def lights_of_shots(shots: Sequence[PlannedShot], lights: Lights | None) -> Lights | None:
    """Return the lights of the shots' LEDs, with the names of the LEDs as ids."""
    if lights is None:
        return None
    leds = [shot.led for shot in shots if shot.role == "light" and shot.led is not None]
    ids = list(dict.fromkeys(map(led_id, leds)))
    indices, _ = lights.match(ids)
    return replace(lights.take(indices), ids=tuple(ids))
