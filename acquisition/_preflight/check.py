"""Result of one pre-flight check."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

State = Literal["ok", "warning", "failed", "not done"]


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
