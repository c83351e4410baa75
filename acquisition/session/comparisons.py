"""Comparisons of frames of the same light in the journal, and what they say about a recording."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from acquisition.comparison import FrameComparison, compare_frames
from acquisition.comparison.frame_comparison import LEAST_PX
from acquisition.plan.planned_shot import ShotKey
from acquisition.session.journal import COMPARED, EventLine
from acquisition.session.manifest import CameraRecord
from acquisition.session.session_frame import SessionFrame
from rig import Notice
from rig.arrays import UInt16

# A shift of 2 pixels of half of the images turns normals by 5.5 degrees, so this one by more than
# 1 degree, and errors of 3 % of the lights turn them by about 1 degree.
_MOVED_PX: Final = 0.5
_FADED: Final = 0.03
_BLURRED: Final = 0.1
# Less light than this is not the same light.
_LOST: Final = 0.2
_SURELY: Final = 3.0

# Findings after which more frames would not fit those that were recorded before.
USELESS: Final = frozenset({"frame-shifted", "light-lost", "object-changed"})

Numbers = Mapping[str, Any]


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
    }


def findings(details: Numbers) -> list[Notice]:
    """Return what a comparison says about a recording; empty if nothing moved or faded.

    Parameters
    ----------
    details
        Details of the event ``compared``.
    """
    since = f"since {details['light']}"
    file = details["file"]
    where = "" if file is None else f"frames/{file}"
    gain, sigma = details["gain"], details["gain_sigma"] or 0.0
    if gain is not None and gain < _LOST:
        text = f"the light fell to {gain:.1%} {since}: check the LED, the lens cap and the object"
        return [Notice("light-lost", text, where)]
    found = []
    right, down = details["shift_px"]
    if None not in (right, down):
        distance, sure = math.hypot(right, down), math.hypot(*details["shift_sigma_px"])
        if distance > _MOVED_PX and distance > _SURELY * sure:
            text = (
                f"the camera or the object moved by {distance:.2f} +- {sure:.2f} px "
                f"({_side(right, 'right', 'left')}, {_side(down, 'down', 'up')}) {since}: put it "
                "back, or record again"
            )
            found.append(Notice("frame-shifted", text, where))
    if details["other_fraction"] is not None and not details["same_object"]:
        left, top, end, bottom = details["other_box"]
        text = (
            f"{details['other_fraction']:.0%} of the image does not fit {details['light']} "
            f"(columns {left} to {end - 1}, rows {top} to {bottom - 1}): another object, or a part "
            "of it moved; put it back, or record again"
        )
        found.append(Notice("object-changed", text, where))
    if gain is not None and abs(gain - 1) > max(_FADED, _SURELY * sigma):
        text = (
            f"the light changed by {gain - 1:+.1%} +- {sigma:.1%} {since}: let the LEDs warm up, "
            "and check their power supply and the room light"
        )
        found.append(Notice("light-changed", text, where))
    focus, sigma = details["focus"], details["focus_sigma"] or 0.0
    if focus is not None and abs(focus - 1) > max(_BLURRED, _SURELY * sigma):
        text = (
            f"the finest structure has {focus:.0%} +- {sigma:.0%} of its contrast {since}: fasten "
            "the focus ring"
        )
        found.append(Notice("focus-changed", text, where))
    return found


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
        for one in findings(details)
    ]


def compared_repeat(
    camera: CameraRecord,
    frames: Iterable[SessionFrame],
    events: Iterable[EventLine],
) -> dict[str, Any] | None:
    """Compare the repeat of a session with its light, unless the journal has this comparison.

    Returns
    -------
    dict or None
        Details of the event ``compared``.

    Raises
    ------
    DataError
        If one of the two frames is damaged.
    """
    by_key: dict[ShotKey, SessionFrame] = {frame.line.key: frame for frame in frames}
    repeat = next((frame for frame in by_key.values() if frame.role == "repeat"), None)
    if repeat is None:
        return None
    light = by_key.get(("light", *repeat.line.key[1:]))
    if light is None:
        return None
    names = Path(repeat.line.file).name, Path(light.line.file).name
    done = (line.details for line in events if line.event == COMPARED)
    if any((one.get("file"), one.get("light")) == names for one in done):
        return None
    return compare_recorded(light, repeat.read(), camera, by_key.values(), names[0])
