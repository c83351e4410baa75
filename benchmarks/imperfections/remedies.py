"""The options that a remedy names, as a user would give them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from acquisition import TransferCurve
from processing.checks import Cause
from sgp.cli.options import transfer_of

_OPTION = re.compile(r"--([a-z-]+)(?:[ =]([\w.,-]+))?")
_SWITCHES = ("semi-calibrated", "rests-on-plane", "distant")
_ESTIMATES = ("ambient", "light-distance-mm")
_CURVES = ("srgb", "linear")
_NUMBERS = ("light-distance-mm", "height-mm", "pixel-mm")


@dataclass(frozen=True)
class Remedy:
    """What to change when a recording is read and reconstructed.

    Parameters
    ----------
    options
        The options as words; empty if nothing changes.
    transfer
        Transfer curve of the samples.
    without
        Images to leave out.
    keywords
        Further keywords of `reconstruct`.
    """

    options: str = ""
    transfer: TransferCurve | None = None
    without: tuple[str, ...] = ()
    keywords: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, cause: Cause) -> Remedy:
        """Return the first remedy of a cause that is an option; other remedies need a person."""
        for name, word in _OPTION.findall(cause.remedy):
            value = word.rstrip(".,")  # the end of a sentence
            options, key = f"--{name} {value}", name.replace("-", "_")
            if name in _SWITCHES:
                return cls(f"--{name}", keywords={key: True})
            if name in _NUMBERS and _is_number(value):
                return cls(options, keywords={key: float(value)})
            if name in _ESTIMATES and value == "estimate":
                return cls(options, keywords={key: value})
            if name == "exclude" and value == "auto":
                return cls(options, keywords={"exclude_disagreeing": True})
            if name == "exclude" and value:
                return cls(options, without=tuple(value.split(",")))
            if name == "gamma" and (value.lower() in _CURVES or _is_number(value)):
                return cls(options, transfer=transfer_of(value))
        return cls()


def _is_number(text: str) -> bool:
    return re.fullmatch(r"[0-9]+(\.[0-9]+)?", text) is not None
