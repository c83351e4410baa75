"""What a command hands back."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sgp._printable import printable_json


@dataclass
class Result:
    """The outcome of a command: files, figures, warnings and what to say to a person.

    Parameters
    ----------
    outputs
        Name to path of every file a caller may want.
    metrics
        Figures by name, units in the name.
    warnings
        One line each.
    summary
        Lines for a person; with ``--json`` they are not shown.
    inputs
        The files that were read, to be recorded by their hashes.
    ok
        False where the command ran but what it examined is not in order.
    failing_code
        The exit code of that: 4 for a recording, 3 for a rig.
    """

    outputs: dict[str, Path] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    summary: list[str] = field(default_factory=list)
    inputs: list[Path] = field(default_factory=list)
    ok: bool = True
    failing_code: int = 4

    def to_json(self) -> str:
        """Return the one object that ``--json`` prints."""
        return dumps(
            {
                "ok": self.ok,
                "outputs": {name: str(path) for name, path in self.outputs.items()},
                "metrics": self.metrics,
                "warnings": self.warnings,
            }
        )


def dumps(value: Mapping[str, Any]) -> str:
    """Return strict JSON: numpy scalars become numbers, what is not finite becomes null.

    Bytes of names that are not UTF-8 become escapes, from which Python reads the same name.
    """
    text = json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False)
    return printable_json(text).encode("utf-8", "backslashreplace").decode()


def plain(value: Any) -> Any:
    """Return a value as JSON knows it: paths as text, arrays as lists, null for NaN."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
