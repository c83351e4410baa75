"""One thing that the self-test has to say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "dead", "dim", "unsteady", "always on", "room light", "double", "elsewhere", "not told apart",
    "trigger", "exposure active",
]  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One thing that is not as it should be, or cannot be judged.

    Parameters
    ----------
    kind
        Short name.
    leds
        The LEDs that it concerns.
    text
        What is seen and what to try, for people.
    fault
        False where nothing is wrong with the rig: a remark.
    """

    kind: Kind
    leds: tuple[int, ...]
    text: str
    fault: bool = True
