"""The result that a command returns."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import processing
import rig
from sgp.cli.exit import UNUSABLE
from sgp.cli.terminal import printable_json
from sgp.results.verdict import verdict_line, verdict_record


@dataclass
class Result:
    """The outcome of a command: files, figures, warnings and lines to print.

    Parameters
    ----------
    outputs
        Path of every file that a caller may use, by name.
    metrics
        Figures by name; the names include the units. `sgp.results.metrics` declares those of
        records.
    warnings
        What must be reported besides the figures, in the order of printing.
    summary
        Lines for the terminal; not printed with ``--json``.
    verdict
        Whether the data or the result can be used; None if the command does not judge it.
    good
        What a good verdict says.
    inputs
        Files that were read; the record contains their hashes.
    parameters
        Parameters that the command chose itself, by name; the record lists them with its arguments.
    ok
        False if the command ran but found faults in the data or the rig that it examined.
    failing_code
        Exit code if ``ok`` is False: 4 for a recording, 3 for a rig, 6 for a verdict.
    """

    outputs: dict[str, Path] = field(default_factory=dict)
    metrics: Mapping[str, object] = field(default_factory=dict)
    warnings: list[rig.Notice] = field(default_factory=list)
    summary: list[str] = field(default_factory=list)
    verdict: processing.checks.Verdict | None = None
    good: str = ""
    inputs: list[Path] = field(default_factory=list)
    parameters: dict[str, Any] = field(default_factory=dict)
    ok: bool = True
    failing_code: int = 4

    @property
    def conclusion(self) -> list[str]:
        """The last line for the terminal, if there is a verdict."""
        return [] if self.verdict is None else [verdict_line(self.verdict, self.good)]

    def refuse_unusable(self) -> None:
        """Fail if the verdict is that the result should not be used."""
        if self.verdict is not None and self.verdict.answer == "do-not-use":
            self.ok, self.failing_code = False, UNUSABLE

    def file(self, name: str, path: Path) -> Path:
        """Add an output; return its path, to which the caller writes it."""
        self.outputs[name] = path
        return path

    def to_json(self) -> str:
        """Return the one object that ``--json`` prints."""
        return dumps(
            {
                "ok": self.ok,
                "outputs": {name: str(path) for name, path in self.outputs.items()},
                "metrics": self.metrics,
                "warnings": [str(notice) for notice in self.warnings],
                "notices": [asdict(notice) for notice in self.warnings],
                **({} if self.verdict is None else verdict_record(self.verdict)),
            }
        )


def json_table(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file; empty if it is no table, cannot be read or is missing."""
    try:
        content = rig.files.parse_json(rig.read_bounded(path))
    except (FileNotFoundError, rig.UnreadableError):
        return {}
    return content if isinstance(content, dict) else {}


def dumps(value: Mapping[str, Any]) -> str:
    """Return strict JSON: numpy scalars become numbers, values that are not finite become null.

    Bytes of names that are not UTF-8 become escapes, which Python decodes to the same name.
    """
    text = json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False)
    return printable_json(text).encode("utf-8", "backslashreplace").decode()


def plain(value: Any) -> Any:
    """Return a value in JSON types: paths as text, arrays as lists, None for NaN and infinity."""
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
