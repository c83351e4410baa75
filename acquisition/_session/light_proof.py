"""Whether a frame was lit as planned, by the word of everything that knows."""

from __future__ import annotations

from collections.abc import Mapping

from acquisition._plan.planned_shot import PlannedShot

BOARD = "the LED board"
RIG = "the rig"


def wrong_light(planned: PlannedShot, lit: Mapping[str, int | None]) -> str | None:
    """Compare the LED that was planned with those that are said to have been on.

    The engine asks when a frame is kept, the writer before it is stored, and every reader of a
    session for each of its lines.

    Parameters
    ----------
    planned
        The shot. A flat of a session without a plan may be lit by any LED, but by one.
    lit
        The LED that was on during the exposure, None where all were off, by who says so (`BOARD`,
        `RIG`); without an entry where nobody does, as in imported sessions.

    Returns
    -------
    str or None
        What does not agree, as the end of a sentence; None where all is well.
    """
    any_led = planned.role == "flat" and planned.lit_led is None
    for who, led in lit.items():
        if (led is None) if any_led else (led != planned.lit_led):
            wanted = "an LED" if any_led else _name(planned.lit_led)
            return f"was planned with {wanted}, but {who} reports {_name(led)}"
    return None


def _name(led: int | None) -> str:
    return "all LEDs off" if led is None else f"LED {led}"
