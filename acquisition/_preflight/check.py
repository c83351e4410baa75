"""Result of one pre-flight check."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal

from rig import Notice, Severity, short_repr

State = Literal["ok", "warning", "failed", "not done"]

_CODES: Final = {
    "disk": "check-disk",
    "board": "check-board",
    "camera": "check-camera",
    "brightness": "check-brightness",
    "response": "check-response",
    "exposure": "check-exposure",
    "focus": "check-focus",
    "room light": "check-room-light",
    "steadiness": "check-steadiness",
    "LEDs": "check-leds",
}
_SEVERITIES: Final[dict[State, Severity]] = {
    "ok": "info",
    "warning": "warning",
    "failed": "error",
    "not done": "info",
}


@dataclass(frozen=True)
class Check:
    """Result of one check.

    Parameters
    ----------
    name
        Name of the check.
    state
        ``ok``; ``warning`` if a recording is still possible; ``failed``; or ``not done`` because an
        earlier check failed or the scene does not allow it.
    text
        One line with the finding and, unless the state is ``ok``, what to do.
    values
        The measured values, with units in their names.
    """

    name: str
    state: State
    text: str
    values: dict[str, float | int | str | None] = field(default_factory=dict)

    __repr__ = short_repr

    @property
    def notice(self) -> Notice:
        """The check as a notice: an error if it failed."""
        return Notice(_CODES[self.name], self.text, self.name, _SEVERITIES[self.state])
