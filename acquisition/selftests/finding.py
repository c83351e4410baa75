"""A finding of the self-test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from rig import Notice

Kind = Literal[
    "dead", "dim", "unsteady", "always on", "room light", "double", "elsewhere", "ambiguous",
    "trigger", "exposure active",
]  # fmt: skip

_CODES: Final[dict[Kind, str]] = {
    "dead": "led-dead",
    "dim": "led-dim",
    "unsteady": "led-unsteady",
    "always on": "led-always-on",
    "room light": "room-light",
    "double": "led-double",
    "elsewhere": "led-elsewhere",
    "ambiguous": "led-ambiguous",
    "trigger": "trigger-wire",
    "exposure active": "exposure-active-wire",
}


@dataclass(frozen=True)
class Finding:
    """A fault of the rig, or a remark on something that cannot be judged.

    Parameters
    ----------
    kind
        Short name of the finding.
    leds
        The LEDs concerned.
    text
        Message for the operator: the observation and what to try.
    fault
        False for a remark, if nothing is wrong with the rig.
    """

    kind: Kind
    leds: tuple[int, ...]
    text: str
    fault: bool = True

    @property
    def notice(self) -> Notice:
        """The finding as a notice: an error if it is a fault, else information."""
        return Notice(_CODES[self.kind], self.text, severity="error" if self.fault else "info")
