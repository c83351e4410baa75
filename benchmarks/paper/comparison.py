"""Tables, pictures and profiles of a comparison with the paper."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import processing
import rig
from benchmarks.paper.tables import Table
from sgp.pictures import Panel


class Picture(NamedTuple):
    """A sheet of panels: its title, its panels and the number of columns."""

    title: str
    panels: list[Panel]
    columns: int


@dataclass
class Comparison:
    """The results of the comparison.

    Parameters
    ----------
    preface
        Introduction to the tables.
    tables, pictures, profiles
        Results; pictures and profiles by name.
    left_out
        Results that could not be computed, with reasons.
    files
        Data files that were read.
    """

    preface: str
    tables: list[Table] = field(default_factory=list)
    pictures: dict[str, Picture] = field(default_factory=dict)
    profiles: dict[str, processing.HeightProfile] = field(default_factory=dict)
    left_out: list[rig.Notice] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)

    def add(self, name: str, title: str, columns: int, table: Table, panels: list[Panel]) -> None:
        """Add a table and a picture with a name and a title."""
        self.tables.append(table)
        self.pictures[name] = Picture(title, panels, columns)

    def without_data(self, consequence: str) -> None:
        """State what the missing data changes."""
        text = f"SGP_DATA is not set: {consequence}"
        self.left_out.append(rig.Notice("bench-without-data", text))

    def shortened(self, consequence: str) -> None:
        """State what --quick changes."""
        text = f"--quick: {consequence}"
        self.left_out.append(rig.Notice("bench-quick", text, severity="info"))
