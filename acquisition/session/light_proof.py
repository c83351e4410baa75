"""Check that a frame was lit as planned, according to the board and the rig."""

from __future__ import annotations

from collections.abc import Mapping

from acquisition.plan.planned_shot import PlannedShot

BOARD = "the LED board"
RIG = "the rig"


def wrong_light(
    planned: PlannedShot, lit: Mapping[str, int | None], *, echoes: bool = False
) -> str | None:
    """Compare the planned LED with the LEDs that were reported as on.

    The engine checks each frame that it takes, the writer each frame before it is stored, and every
    reader of a session each line.

    Parameters
    ----------
    planned
        The shot. A flat of a session without a plan may be lit by any LED, but needs one.
    lit
        The LED that was on during the exposure, None if all were off, by the device that reported
        it (`BOARD`, `RIG`); no entry if there is no report, as in imported sessions.
    echoes
        Whether the board reports on every frame of the session.

    Returns
    -------
    str or None
        The contradiction, as the end of a sentence; None if all reports agree with the plan.
    """
    if echoes and BOARD not in lit:
        return f"has no echo, by which {BOARD} confirms the light of every frame of this session"
    any_led = planned.role == "flat" and planned.led is None
    for reporter, led in lit.items():
        if (led is None) if any_led else (led != planned.led):
            expected = "an LED" if any_led else _name(planned.led)
            return f"was planned with {expected}, but {reporter} reports {_name(led)}"
    return None


def _name(led: int | None) -> str:
    return "all LEDs off" if led is None else f"LED {led}"
