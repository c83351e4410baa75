"""Result of one pre-flight check."""

from __future__ import annotations

from collections.abc import Mapping
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
    # Findings after which a recording is useless.
    "exposure-saturated": "exposure-saturated",
    "exposure-too-dark": "exposure-too-dark",
    "room-light-strong": "room-light-strong",
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
    doubt
        Code of a finding after which a recording is useless unless it is accepted; otherwise empty.
    findings
        The findings, if there are several, each with what to do; ``text`` joins them.
    """

    name: str
    state: State
    text: str
    values: Mapping[str, float | int | str | None] = field(default_factory=dict)
    findings: tuple[str, ...] = ()
    doubt: str = ""

    __repr__ = short_repr

    @property
    def lines(self) -> tuple[str, ...]:
        """The text as one line for each finding."""
        return self.findings or (self.text,)

    @property
    def notices(self) -> tuple[Notice, ...]:
        """The check as notices, one for each finding: errors if it failed."""
        severity = _SEVERITIES[self.state]
        of = self.doubt or self.name
        return tuple(Notice(_CODES[of], line, self.name, severity) for line in self.lines)
