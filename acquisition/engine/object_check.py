"""The check that the object of a session is still in place when it is resumed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

from acquisition._errors import DataError, NotAcceptedError
from acquisition.engine.recording_loop import OnDoubt
from acquisition.plan.plan import CapturePlan
from acquisition.session.comparisons import USELESS, compare_recorded, findings
from acquisition.session.session import Session
from acquisition.session.session_frame import SessionFrame
from rig import Rig

# Damaged frames that are passed over in search of one to compare with.
_MOST_TRIED: Final = 3


def check_object(
    rig: Rig, session: Session, plan: CapturePlan, accept: OnDoubt
) -> dict[str, Any] | None:
    """Repeat the last good light of a session and compare both frames.

    Parameters
    ----------
    rig
        Open rig.
    session
        The session; nothing is written to it.
    plan
        Its plan.
    accept
        Asked about each finding after which further frames would not fit.

    Returns
    -------
    dict or None
        Details of the event ``compared``; None if there is nothing to compare with.

    Raises
    ------
    NotAcceptedError
        If a finding is not accepted.
    RigError
        If board or camera fail.
    """
    for light in _last_lights(session, rig.config.dead_leds):
        if light.line.led is None:
            continue
        exposure_us = plan.exposure_us(light.line.led, light.bracket)
        camera = session.manifest.camera
        try:
            light.read()
        except DataError:
            continue  # a damaged frame is reported elsewhere
        pixels = rig.shoot(light.line.led, exposure_us, plan.gain_db).frame.pixels
        details = compare_recorded(light, pixels, camera, session.frames, None)
        if details is None:
            return None
        accepted = []
        for one in findings(details):
            if one.code in USELESS:
                finding = replace(one, where=str(session.folder), severity="error")
                if not accept(finding):
                    raise NotAcceptedError(finding)
                accepted.append(one.code)
        return {**details, "accepted": accepted}
    return None


def _last_lights(session: Session, dead_leds: tuple[int, ...]) -> Iterator[SessionFrame]:
    """Yield the last lights of LEDs that work, the latest first."""
    lights = [
        frame for frame in session.frames if frame.role == "light" and frame.led not in dead_leds
    ]
    yield from sorted(lights, key=lambda frame: -frame.line.seq)[:_MOST_TRIED]
