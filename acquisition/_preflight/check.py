"""One line of a pre-flight: what was looked at, and how it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

State = Literal["ok", "warning", "failed", "not done"]


@dataclass(frozen=True)
class Check:
    """What one check found.

    Parameters
    ----------
    name
        What was looked at.
    state
        ``ok``; ``warning``, where a recording is possible; ``failed``; or ``not done``, because a
        check before it failed or the scene does not allow it.
    text
        What was found and, where it is not ok, what to do; one line.
    values
        The figures behind it, units in their names.
    """

    name: str
    state: State
    text: str
    values: dict[str, float | int | str | None] = field(default_factory=dict)
