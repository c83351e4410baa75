"""A notice: what a function reports to people besides its result."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal, get_args

Severity = Literal["info", "warning", "error"]

_CODE: Final = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


@dataclass(frozen=True)
class Notice:
    """One line for people, with a code for programs.

    ``str`` of a notice is the line with the place: ``where: text``.

    Parameters
    ----------
    code
        Stable name in kebab case, for example ``lights-unlit``; ``docs/notices.md`` lists all.
    text
        One line for people, without the place.
    where
        The file, frame, LED or sphere that the notice is about; empty if ``text`` names it or if
        there is no single one.
    severity
        ``info`` if nothing is wrong, ``warning`` if the result may be affected, ``error`` if
        something must be repaired.

    Raises
    ------
    ValueError
        If the code is not in kebab case, or the severity is not one of the three.
    """

    code: str
    text: str
    where: str = ""
    severity: Severity = "warning"

    def __post_init__(self) -> None:
        if not _CODE.fullmatch(self.code):
            raise ValueError(f"code {self.code!r} of a notice is not in kebab case")
        if self.severity not in get_args(Severity):
            raise ValueError(
                f"severity {self.severity!r} of a notice is not one of {get_args(Severity)}"
            )

    def __str__(self) -> str:
        return f"{self.where}: {self.text}" if self.where else self.text
