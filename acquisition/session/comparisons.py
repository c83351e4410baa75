"""Comparisons of frames of the same light in the journal, and what they say about a recording."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Protocol

from acquisition.comparison import FrameComparison, compare_frames
from acquisition.comparison.frame_comparison import LEAST_PX
from acquisition.plan.planned_shot import ShotKey
from acquisition.session.journal import COMPARED, EventLine
from acquisition.session.manifest import CameraRecord, Manifest
from acquisition.session.session_frame import SessionFrame
from rig import Notice
from rig.arrays import UInt16

# Changes that are named, by quantity: pixels, and shares of the light, of the contrast and of the
# image.
_NAMED: Final = {"shift": 0.3, "gain": 0.01, "gain_spread": 0.01, "focus": 0.1, "other": 0.01}
# A shift of 2 pixels of half of the images turns normals by 5.5 degrees, so this one by more than
# 1 degree.
_MOVED_PX: Final = 0.5
# Less light than this is not the same light.
_LOST: Final = 0.2
_USELESS_FROM: Final = {"shift": _MOVED_PX, "gain": 1 - _LOST}
_SURELY: Final = 3.0
# An uneven light whose structure differs in less than this share of the image is of the same
# object: lamps that moved by up to a quarter of their distance change less than 0.09, other objects
# more than 0.35.
_ALIKE: Final = 0.2
# A change is sudden if at least this share of it came after the repeat before.
_SUDDEN: Final = 0.5
# A change is named again when it has grown by this share.
_GROWN: Final = 0.5

# Findings after which more frames would not fit those that were recorded before.
USELESS: Final = frozenset({"frame-shifted", "light-lost", "light-turned", "object-changed"})

Numbers = Mapping[str, Any]


class RecordedFrames(Protocol):
    """What is needed of a `Session`."""

    @property
    def manifest(self) -> Manifest:
        """Content of ``session.toml``."""

    @property
    def frames(self) -> Sequence[SessionFrame]:
        """The frames that count."""

    @property
    def events(self) -> Sequence[EventLine]:
        """All events."""


def compare_recorded(
    light: SessionFrame,
    pixels: UInt16,
    camera: CameraRecord,
    frames: Iterable[SessionFrame],
    file: str | None,
) -> dict[str, Any] | None:
    """Compare a recorded light with later pixels of the same light.

    Parameters
    ----------
    light
        The recorded frame.
    pixels
        Samples under the same LED with the same exposure time and gain.
    camera
        Camera record of the session.
    frames
        Frames of the session; those with all LEDs off are the level without light.
    file
        Name of the frame of the pixels, None if it is not stored.

    Returns
    -------
    dict or None
        Details of the event ``compared``; None if the frames are too small to be compared.

    Raises
    ------
    DataError
        If the recorded frame is damaged.
    """
    if min(pixels.shape[:2]) < LEAST_PX:
        return None
    unlit = {
        frame.role: frame.line.mean_dn
        for frame in frames
        if frame.led is None and frame.exposure_us == light.exposure_us
    }
    black_dn = unlit.get("ambient") or unlit.get("dark") or camera.black_level_dn
    compared = compare_frames(
        light.read(),
        pixels,
        black_level_dn=black_dn,
        white_level_dn=camera.white_dn,
        mosaic=camera.cfa is not None,
    )
    return {"file": file, "light": Path(light.line.file).name, **_numbers(compared)}


def _numbers(compared: FrameComparison) -> dict[str, Any]:
    def known(value: float) -> float | None:
        return None if math.isnan(value) or math.isinf(value) else round(value, 5)

    return {
        "shift_px": [known(px) for px in compared.shift_px],
        "shift_sigma_px": [known(px) for px in compared.shift_sigma_px],
        "gain": known(compared.gain),
        "gain_sigma": known(compared.gain_sigma),
        "focus": known(compared.focus),
        "focus_sigma": known(compared.focus_sigma),
        "other_fraction": known(compared.other_fraction),
        "other_box": None if compared.other_box is None else list(compared.other_box),
        "same_object": compared.same_object,
        "gain_spread": known(compared.gain_spread),
        "gain_spread_sigma": known(compared.gain_spread_sigma),
        "unlike_fraction": known(compared.unlike_fraction),
    }


def findings(details: Numbers, earlier: Sequence[Numbers] = ()) -> list[Notice]:
    """Return what a comparison says about a recording; empty if nothing moved or faded.

    Parameters
    ----------
    details
        Details of the event ``compared``.
    earlier
        Those of the earlier repeats of the same light, in order: what they showed already is not
        named again.
    """
    file, light = details["file"], details["light"]
    where = "" if file is None else f"frames/{file}"
    found: list[Notice] = []
    changes = _changes(details, earlier)
    since = {kind: f"since {light}{_when(kind, details, earlier)}" for kind in changes}
    gain, sigma = details["gain"], details["gain_sigma"] or 0.0
    if gain is not None and gain < _LOST:
        if "gain" in changes:
            text = f"the light fell to {gain:.1%} {since['gain']}: check the LED, the lens cap and "
            found.append(Notice("light-lost", f"{text}the object", where))
        return found
    same, uneven = details["same_object"], _is_uneven(details)
    right, down = details["shift_px"]
    if "shift" in changes:
        distance, sure = math.hypot(right, down), _value("shift", details)[1]
        text = (
            f"the camera or the object moved by {distance:.2f} +- {sure:.2f} px "
            f"({_side(right, 'right', 'left')}, {_side(down, 'down', 'up')}) {since['shift']}: put "
            "it back, or record again"
        )
        if distance > _MOVED_PX:
            found.append(Notice("frame-shifted", text, where))
        elif not uneven:
            found.append(Notice("frame-drifted", text, where))
    if uneven and "gain_spread" in changes:
        spread, sure = details["gain_spread"], details["gain_spread_sigma"]
        text = (
            f"the light changed by {gain - 1:+.1%}, and unevenly by {spread:.1%} +- {sure:.1%}, "
            f"{since['gain_spread']}: its LED moved or the object turned; put it back, or record "
            "again"
        )
        if same:
            found.append(Notice("light-changed", text, where))
        else:
            found.append(Notice("light-turned", text, where))
    if "other" in changes and not same and not uneven:
        left, top, end, bottom = details["other_box"]
        text = (
            f"{details['other_fraction']:.0%} of the image does not fit {light} (columns {left} to "
            f"{end - 1}, rows {top} to {bottom - 1}){_when('other', details, earlier)}: another "
            "object, or a part of it or the LED moved; put it back, or record again"
        )
        found.append(Notice("object-changed", text, where))
    if "gain" in changes and not uneven:
        text = (
            f"the light changed by {gain - 1:+.1%} +- {sigma:.1%} {since['gain']}: let the LEDs "
            "warm up, and check the LED, the power supply and the room light"
        )
        found.append(Notice("light-changed", text, where))
    if "focus" in changes and not uneven:
        focus, sigma = details["focus"], details["focus_sigma"] or 0.0
        text = (
            f"the finest structure has {focus:.0%} +- {sigma:.0%} of its contrast "
            f"{since['focus']}: fasten the focus ring"
        )
        found.append(Notice("focus-changed", text, where))
    return found


def _is_uneven(details: Numbers) -> bool:
    """Return whether the same object in the same place was lit from another direction."""
    value, sigma = _value("gain_spread", details)
    unlike = details.get("unlike_fraction")
    if value is None or unlike is None or details["gain"] is None:
        return False
    # Shading that changes looks like a shift by less.
    here = abs(_value("shift", details)[0] or 0) <= _MOVED_PX
    return here and unlike < _ALIKE and _exceeds("gain_spread", value, sigma)


def _value(kind: str, details: Numbers) -> tuple[complex | None, float]:
    """Return the deviation of a quantity from the light, and its standard deviation."""
    if kind == "shift":
        right, down = details["shift_px"]
        if None in (right, down):
            return None, 0.0
        return complex(right, down), math.hypot(*(px or 0.0 for px in details["shift_sigma_px"]))
    if kind == "other":
        return details["other_fraction"], 0.0
    value, sigma = details.get(kind), details.get(f"{kind}_sigma") or 0.0
    return (value if value is None or kind == "gain_spread" else value - 1), sigma


def _exceeds(kind: str, value: complex, sigma: float) -> bool:
    return abs(value) > max(_NAMED[kind], _SURELY * sigma)


def _changes(details: Numbers, earlier: Sequence[Numbers]) -> set[str]:
    """Return the quantities whose deviation is new, or has grown by half since it was named."""
    new = set[str]()
    for kind, least in _NAMED.items():
        named: complex = 0
        for one in (*earlier, details):
            value, sigma = _value(kind, one)
            new.discard(kind)
            if value is None:
                continue
            useless = abs(named) <= _USELESS_FROM.get(kind, math.inf) < abs(value)
            grown = abs(value - named) > max(least, abs(named) * _GROWN)
            if _exceeds(kind, value, sigma) and (grown or useless):
                new.add(kind)
                named = value
            elif abs(value) < least / 2:  # back in place
                named = 0
    return new


def _when(kind: str, details: Numbers, earlier: Sequence[Numbers]) -> str:
    """Return when a change happened, as far as the repeat before shows it."""
    if not earlier or details.get("lights_before") is None:
        return ""
    now, before = _value(kind, details)[0], _value(kind, earlier[-1])[0]
    if now is None or before is None or earlier[-1].get("lights_before") is None:
        return ""
    if abs(now - before) < _SUDDEN * abs(now):
        return ", gradually"
    numbers = earlier[-1]["lights_before"], details["lights_before"]
    return f", between the lights {numbers[0]} and {numbers[1]}"


def _side(px: float, positive: str, negative: str) -> str:
    return f"{abs(px):.2f} {positive if px >= 0 else negative}"


def comparison_notices(folder: Path, events: Iterable[EventLine]) -> list[Notice]:
    """Return the findings of all comparisons of a session; of several of one frame, the last."""
    last = {
        (line.details.get("file"), line.details.get("light")): line.details
        for line in events
        if line.event == COMPARED
    }
    return [
        replace(one, where=str(folder / one.where))
        for details in last.values()
        for one in findings(details, earlier_repeats(details, last.values()))
    ]


def earlier_repeats(details: Numbers, comparisons: Iterable[Numbers]) -> list[Numbers]:
    """Return the comparisons of repeats of the same light before that of ``details``."""
    number = details.get("lights_before")
    if number is None:
        return []
    known = {
        one.get("lights_before") or number: one
        for one in comparisons
        if one["light"] == details["light"]
    }
    return [known[before] for before in sorted(known) if before < number]


def compared_repeats(session: RecordedFrames, only: str | None = None) -> Iterator[dict[str, Any]]:
    """Compare repeats with their light, unless the journal has this comparison.

    Parameters
    ----------
    session
        The session.
    only
        Path of a frame as in its line, to compare no other.

    Yields
    ------
    dict
        Details of the event ``compared``.

    Raises
    ------
    DataError
        If a frame is damaged.
    """
    plan = session.manifest.plan
    lights_before = () if plan is None else plan.lights_before_repeats
    by_key: dict[ShotKey, SessionFrame] = {frame.line.key: frame for frame in session.frames}
    done = [line.details for line in session.events if line.event == COMPARED]
    pairs = {(one.get("file"), one.get("light")) for one in done}
    for repeat in session.frames:
        light = by_key.get(("light", repeat.line.led, repeat.bracket, 0))
        if repeat.role != "repeat" or light is None or only not in (None, repeat.line.file):
            continue
        names = Path(repeat.line.file).name, Path(light.line.file).name
        if names in pairs:
            continue
        details = compare_recorded(
            light, repeat.read(), session.manifest.camera, session.frames, names[0]
        )
        if details is not None:
            yield {**details, "lights_before": lights_before[repeat.line.repeat]}
