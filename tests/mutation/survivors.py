"""Faults that no test can or must detect, each with its reason."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from tests.mutation.operators import Mutant

_FILE = Path(__file__).with_name("survivors.toml")


@dataclass(frozen=True)
class Survivors:
    """The entries of ``survivors.toml``, by module, function, line before and line after."""

    reasons: dict[tuple[str, str, str, str], str]

    @classmethod
    def read(cls) -> Survivors:
        """Read the list.

        Raises
        ------
        ValueError
            If a fault is listed twice.
        """
        reasons: dict[tuple[str, str, str, str], str] = {}
        for entry in tomllib.loads(_FILE.read_text(encoding="utf-8")).get("survivor", []):
            key = entry["module"], entry["function"], entry["before"], entry["after"]
            if key in reasons:
                raise ValueError(f"{_FILE.name} lists twice: {key}")
            reasons[key] = entry["reason"]
        return cls(reasons)

    def reason(self, module: str, mutant: Mutant) -> str | None:
        """Return the reason why a fault may survive, or None if it is not listed."""
        return self.reasons.get((module, *mutant.key))
