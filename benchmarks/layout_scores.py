"""Scores of random layouts of spheres, and the table of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

TOLERABLE_MM = 2.0
SOLVABLE_MM = 1.0


@dataclass
class Score:
    """What was found in one layout."""

    seed: int
    kind: str
    wanted: int = 0
    found: int = 0
    missed: list[str] = field(default_factory=list)
    false: list[str] = field(default_factory=list)
    expected_mm: float = np.inf
    positions_mm: float = np.nan
    stated_mm: float = np.nan
    warnings: tuple[str, ...] = ()
    error: str = ""
    failed: bool = False
    cpu_s: float = 0.0

    @property
    def solvable(self) -> bool:
        """Return whether positions within 2 mm can be expected."""
        return self.expected_mm <= SOLVABLE_MM

    @property
    def quiet(self) -> bool:
        """Return whether positions were returned without a warning."""
        return bool(np.isfinite(self.positions_mm)) and not self.warnings

    @property
    def wrong(self) -> bool:
        """Return whether positions are farther off than tolerable, and no warning says so."""
        return self.quiet and self.positions_mm > TOLERABLE_MM

    def line(self) -> str:
        """Return one line for people."""
        parts = [f"{self.seed} {self.kind}: {self.found}/{self.wanted} found"]
        if np.isfinite(self.expected_mm):
            parts.append(f"expected {self.expected_mm:.2f} mm")
        if self.missed:
            parts.append("missed " + " ".join(self.missed))
        if self.false:
            parts.append("FALSE " + " ".join(self.false))
        if np.isfinite(self.positions_mm):
            parts.append(f"positions {self.positions_mm:.2f} mm, stated {self.stated_mm:.2f} mm")
        if self.warnings:
            parts.append("warned " + ",".join(self.warnings))
        if self.error:
            parts.append(("FAILED " if self.failed else "") + self.error[:110])
        return "; ".join([*parts, f"{self.cpu_s:.1f} s"])


def append_score(path: Path, code: str, score: Score) -> None:
    """Append a score to a file, as one line of JSON that names the version of the code."""
    with path.open("a") as file:
        file.write(json.dumps({"code": code, **asdict(score)}) + "\n")


def read_scores(path: Path, code: str) -> list[Score]:
    """Return the scores of this version of the code in a file; a torn line does not count."""
    scores = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            values = json.loads(line)
        except json.JSONDecodeError:
            continue
        if values.pop("code") == code:
            scores.append(Score(**{**values, "warnings": tuple(values["warnings"])}))
    return scores


def table(scores: Sequence[Score]) -> str:
    """Return one table of all scores, with a column for each kind of board."""
    kinds = list(dict.fromkeys(score.kind for score in scores))
    columns = [sorted((s for s in scores if s.kind == k), key=lambda s: s.seed) for k in kinds]
    lines = ["| | " + " | ".join(kinds) + " |", "|---" * (len(kinds) + 1) + "|"]
    lines += [f"| {name} | " + " | ".join(map(cell, columns)) + " |" for name, cell in _ROWS]
    return "\n".join(lines)


def _found(scores: list[Score]) -> str:
    wanted, found = sum(s.wanted for s in scores), sum(s.found for s in scores)
    return f"{found} of {wanted} ({100 * found / max(wanted, 1):.1f} %)"


def _share(chosen: Callable[[Score], bool]) -> Callable[[list[Score]], str]:
    """Return a function that counts which of the chosen layouts have no warning."""

    def cell(scores: list[Score]) -> str:
        some = [score for score in scores if chosen(score)]
        quiet = sum(score.quiet for score in some)
        return f"{quiet} of {len(some)} ({100 * quiet / max(len(some), 1):.0f} %)"

    return cell


def _seeds(chosen: Callable[[Score], object]) -> Callable[[list[Score]], str]:
    """Return a function that lists the seeds of the chosen layouts."""

    def cell(scores: list[Score]) -> str:
        return ", ".join(str(score.seed) for score in scores if chosen(score)) or "none"

    return cell


def _errors(scores: list[Score]) -> str:
    off = [score.positions_mm for score in scores if score.quiet]
    spread = f", {min(off):.2f} to {max(off):.2f} mm, median {np.median(off):.2f}" if off else ""
    return f"{len(off)}{spread}"


def _warned(scores: list[Score]) -> str:
    return (
        "; ".join(
            f"{s.seed} {s.positions_mm:.2f} mm {','.join(s.warnings) or s.error[:40]}"
            for s in scores
            if s.solvable and not s.quiet
        )
        or "none"
    )


def _cpu(scores: list[Score]) -> str:
    seconds = [score.cpu_s for score in scores]
    return f"{np.mean(seconds):.1f} s mean, {max(seconds):.1f} s most"


_ROWS: tuple[tuple[str, Callable[[list[Score]], str]], ...] = (
    ("layouts", lambda scores: str(len(scores))),
    ("spheres found", _found),
    ("false spheres", lambda scores: str(sum(len(s.false) for s in scores))),
    ("seeds with a missed sphere", _seeds(lambda s: s.missed)),
    ("seeds with a false sphere", _seeds(lambda s: s.false)),
    ("position sets without a warning", _errors),
    (f"of these beyond {TOLERABLE_MM:g} mm", lambda scores: str(sum(s.wrong for s in scores))),
    (f"seeds beyond {TOLERABLE_MM:g} mm without a warning", _seeds(lambda s: s.wrong)),
    ("solvable layouts without a warning", _share(lambda s: s.solvable)),
    ("layouts with two spheres or more without a warning", _share(lambda s: s.wanted > 1)),
    ("solvable, but not without a warning", _warned),
    ("seeds that failed", _seeds(lambda s: s.failed)),
    ("CPU of a calibration", _cpu),
)
