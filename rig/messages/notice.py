"""What functions report to people besides their result: notices, counts and progress."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
from typing import Final, Literal, Protocol, get_args

Severity = Literal["info", "warning", "error"]

_CODE: Final = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


@dataclass(frozen=True)
class Notice:
    """One line for people, with a code for programs.

    ``str`` of a notice is the line with the place: ``where: text``.

    Parameters
    ----------
    code
        Stable name in kebab case, for example ``lights-unlit``; the site lists all.
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

    @property
    def label(self) -> str:
        """The severity for people: ``note``, ``warning`` or ``error``.

        Examples
        --------
        >>> from rig import Notice
        >>> notice = Notice("frames-missing", "3 frames are missing", "owl", "info")
        >>> f"{notice.label}: {notice}"
        'note: owl: 3 frames are missing'
        """
        return "note" if self.severity == "info" else self.severity

    def __str__(self) -> str:
        return f"{self.where}: {self.text}" if self.where else self.text


def listed(names: Iterable[str], most: int = 6, separator: str = ", ") -> str:
    """Return the first names of a list, and how many more there are.

    Examples
    --------
    >>> from rig import listed
    >>> listed(["L01", "L02", "L03", "L04"], 2)
    'L01, L02 and 2 more'
    """
    every = list(names)
    before = " " if separator == ", " else separator
    more = f"{before}and {len(every) - most} more" if len(every) > most else ""
    return f"{separator.join(every[:most])}{more}"


def figure(value: float, digits: int = 2) -> str:
    """Return a number with so many digits, without an exponent.

    Examples
    --------
    >>> from rig import figure
    >>> figure(0.1234), figure(218.4), figure(0.000051)
    ('0.12', '220', '0.000051')
    """
    text = f"{value:.{digits}g}"
    return format(Decimal(text), "f") if "e" in text else text


def pluralize(count: int, singular: str, plural: str | None = None) -> str:
    """Return a count and its noun in the right number: ``1 frame``, ``3 frames``.

    Parameters
    ----------
    count
        The number.
    singular
        The words for 1, which may include the verb: ``frame is``.
    plural
        The words for other numbers. Default: ``singular`` with an s.

    Examples
    --------
    >>> from rig import pluralize
    >>> pluralize(1, "frame"), pluralize(3, "frame is", "frames are")
    ('1 frame', '3 frames are')
    """
    return f"{count} {singular if count == 1 else plural or f'{singular}s'}"


class Progress(Protocol):
    """Callback that receives the progress of a long operation. An error it raises ends it."""

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """Report that ``done`` of ``total`` steps of a stage are finished.

        Parameters
        ----------
        stage
            Name of the stage for the user, for instance ``reading``.
        done, total
            Numbers of steps of this stage. ``total`` may grow while the stage runs.
        """
        ...


def no_progress(stage: str, done: int, total: int, /) -> None:
    """Report nothing; the default of functions that take a `Progress`.

    Examples
    --------
    >>> from rig import no_progress
    >>> no_progress("reading", 3, 12)
    """
