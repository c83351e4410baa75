"""Findings that make a recording useless: accepted by an option, or by the operator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from cyclopts import Parameter

import acquisition
import rig as rigs
from sgp.sessions.audience import Audience

Code = Literal[
    "exposure-saturated",
    "exposure-too-dark",
    "frame-shifted",
    "light-lost",
    "object-changed",
    "room-light-strong",
]
Accepted = Annotated[tuple[Code, ...], Parameter(negative=(), consume_multiple=False)]


class Acceptance:
    """Answers whether to continue after findings that make a recording useless.

    Parameters
    ----------
    codes
        Codes of the findings that are accepted.
    audience
        Asked about others.
    """

    def __init__(self, codes: Sequence[Code] = (), audience: Audience | None = None) -> None:
        self._codes = codes
        self._audience = audience or Audience()

    def __call__(self, finding: rigs.Notice) -> bool:
        """Return whether a finding is accepted."""
        return finding.code in self._codes or self._audience.question(finding)

    def require(self, finding: rigs.Notice) -> None:
        """Refuse a finding that is not accepted.

        Raises
        ------
        NotAcceptedError
            If it is not accepted.
        """
        if not self(finding):
            raise acquisition.NotAcceptedError(finding)
