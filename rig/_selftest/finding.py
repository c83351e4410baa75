"""A finding of the self-test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "dead", "dim", "unsteady", "always on", "room light", "double", "elsewhere", "ambiguous",
    "trigger", "exposure active",
]  # fmt: skip


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
