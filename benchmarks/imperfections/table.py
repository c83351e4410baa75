"""The table: one row for each imperfect recording, in a CSV file that grows."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.imperfections.cases import CASES, NONE, Case
from benchmarks.imperfections.recordings import Recording
from benchmarks.imperfections.trials import Outcome

# An error beyond the clean one, in degrees, that matters.
_MATTERS_DEG = 1.0


@dataclass(frozen=True)
class Key:
    """What a row is about.

    Parameters
    ----------
    scene, seed
        The scene; real recordings have the seed 0.
    case, strength
        Imperfections and their strengths; two of them are joined by ``+``.
    """

    scene: str
    seed: str
    case: str
    strength: str


def cases_of(key: Key) -> list[Case]:
    return [CASES[name] for name in key.case.split("+")]


@dataclass(frozen=True)
class Row:
    """An imperfect recording.

    Parameters
    ----------
    lights
        How many, and ``near`` or ``distant``.
    shown
        Whether the images can show the imperfection.
    named
        Whether the verdict names it among the first two causes or their alternatives.
    listed
        Whether the verdict lists it among the causes that the images cannot show.
    """

    key: Key
    lights: str
    shown: bool
    named: bool
    listed: bool
    outcome: Outcome

    @classmethod
    def of(cls, key: Key, recording: Recording, outcome: Outcome) -> Row:
        """Judge an outcome; the recording is the clean one."""
        kind = "near" if recording.lights.near else "distant"
        cases = cases_of(key)
        found = _names(outcome)
        return cls(
            key,
            f"{len(recording.lights)} {kind}",
            all(case.shown_by(recording) for case in cases),
            any(case.named_in(found, recording) for case in cases),
            any(case.named_in(outcome.not_excluded.split(), recording) for case in cases),
            outcome,
        )

    def __str__(self) -> str:
        key, outcome = self.key, self.outcome
        about = f"{key.scene:10} {key.seed:5} {key.case:22} {key.strength:6}"
        errors = f"{outcome.error_deg:6.2f} deg, stated {outcome.sigma_deg:5.2f}"
        return f"{about} {errors} {outcome.answer:10} {outcome.causes or outcome.text}"

    @property
    def warned(self) -> bool:
        return self.outcome.answer != "good"

    @property
    def has_truth(self) -> bool:
        return not math.isnan(self.outcome.error_deg)

    def harm_deg(self, clean: Row) -> float:
        """Return the error of the normals beyond the clean one; infinite for a refusal."""
        if self.outcome.answer == "refused":
            return float("inf")
        if not self.has_truth:
            return self.outcome.change_deg
        return self.outcome.error_deg - clean.outcome.error_deg

    def harms(self, clean: Row) -> bool:
        """Return whether the harm exceeds 1 degree and what is stated of the clean result."""
        stated = clean.outcome.sigma_deg
        return self.harm_deg(clean) > max(0.0 if math.isnan(stated) else stated, _MATTERS_DEG)


def _names(outcome: Outcome) -> set[str]:
    """Return the names of the first two causes, their alternatives, and what is unexplained."""
    names = {name for cause in outcome.causes.split()[:2] for name in cause.split("/")}
    if _FACES_AWAY in outcome.text:
        names.add("lights-reversed")
    return names | ({_UNEXPLAINED} & set(outcome.codes.split()))


_UNEXPLAINED = "residual-unexplained"
# A refusal that names the sign of z.
_FACES_AWAY = "face away from the camera"
_KEYS = ("scene", "seed", "case", "strength")
_JUDGED, _YES = ("shown", "named", "listed"), "yes"


class Table:
    """Rows in a CSV file; those that are in it are not computed again.

    Parameters
    ----------
    path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows: dict[Key, Row] = {}
        if path.exists():
            with path.open(encoding="utf-8", newline="") as file:
                for columns in csv.DictReader(file):
                    row = _row(columns)
                    self.rows[row.key] = row

    def __contains__(self, key: Key) -> bool:
        return key in self.rows

    def add(self, row: Row) -> None:
        """Append a row to the file."""
        columns = _columns(row)
        new = not self._path.exists()
        with self._path.open("a", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            if new:
                writer.writeheader()
            writer.writerow(columns)
        self.rows[row.key] = row

    def clean(self, row: Row) -> Row | None:
        """Return the row of the clean recording."""
        return self.rows.get(Key(row.key.scene, row.key.seed, NONE, "0"))

    def imperfect(self) -> Iterator[tuple[Row, Row]]:
        """Yield the rows with an imperfection, each with its clean one."""
        for row in self.rows.values():
            clean = self.clean(row)
            if row.key.case != NONE and clean is not None:
                yield row, clean


def _columns(row: Row) -> dict[str, str]:
    key = {name: getattr(row.key, name) for name in _KEYS}
    judged = {name: _YES if getattr(row, name) else "no" for name in _JUDGED}
    return key | {"lights": row.lights} | judged | row.outcome.columns()


def _row(columns: dict[str, str]) -> Row:
    return Row(
        Key(*(columns[name] for name in _KEYS)),
        columns["lights"],
        outcome=Outcome.of(columns),
        **{name: columns[name] == _YES for name in _JUDGED},
    )
