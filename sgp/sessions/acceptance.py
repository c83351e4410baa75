"""Findings that make a recording useless: accepted by an option, or by the operator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, get_args

from cyclopts import Parameter

import acquisition
import rig as rigs
from sgp.cli.console import report
from sgp.sessions.audience import Audience

Code = Literal[
    "exposure-saturated",
    "exposure-too-dark",
    "frame-shifted",
    "light-lost",
    "light-turned",
    "object-changed",
    "room-light-strong",
]
Accepted = Annotated[tuple[Code, ...], Parameter(negative=(), consume_multiple=False)]


class Acceptance:
    """Answers whether to continue after findings.

    Parameters
    ----------
    codes
        Codes of the findings that are accepted.
    audience
        Those who follow the recording; asked about others, once for each code.
    """

    def __init__(self, codes: Sequence[Code] = (), audience: Audience | None = None) -> None:
        self._codes: set[str] = {*codes}
        self.audience = audience or Audience()

    def __call__(self, finding: rigs.Notice) -> bool:
        """Return whether a finding is accepted.

        Findings that do not make a recording useless are accepted if the audience cannot answer.
        """
        known = finding.code in self._codes
        if known or (finding.code not in get_args(Code) and not self.audience.answers):
            if finding.severity == "warning":  # of the recording, which the session keeps
                report(finding)
            return True
        if not self.audience.question(finding):
            return False
        self._codes.add(finding.code)
        return True

    def require(self, finding: rigs.Notice) -> None:
        """Refuse a finding that is not accepted.

        Raises
        ------
        NotAcceptedError
            If it is not accepted.
        """
        if not self(finding):
            raise acquisition.NotAcceptedError(finding)
