"""Tables of the comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

Number = float | None


@dataclass(frozen=True)
class Table:
    """Figures measured here, and those that the paper prints.

    Parameters
    ----------
    key
        Name of the table in the JSON file.
    title
        Title; the row names contain the units.
    columns, rows
        Measured figures: rows with one figure per column; None for a missing figure.
    note
        What a reader must know, for example how the paper's figures differ.
    paper_columns, paper_rows
        Figures that the paper prints, if it does.
    """

    key: str
    title: str
    columns: tuple[str, ...]
    rows: Mapping[str, Sequence[Number]]
    note: str
    paper_columns: tuple[str, ...] = ()
    paper_rows: Mapping[str, Sequence[Number]] = field(default_factory=dict)


def flattened(table: Mapping[str, Mapping[str, Sequence[Number]]]) -> dict[str, Sequence[Number]]:
    """Flatten rows by quantity and method to rows named ``quantity, method``."""
    return {
        f"{name}, {method}": row for name, rows in table.items() for method, row in rows.items()
    }


def markdown(table: Table) -> str:
    """Return a table as Markdown: first the measured figures, then those of the paper."""
    parts = [f"## {table.title}", "Here:", _grid(table.columns, table.rows)]
    if table.paper_rows:
        parts += ["The paper:", _grid(table.paper_columns, table.paper_rows)]
    return "\n\n".join([*parts, table.note])


def _grid(columns: tuple[str, ...], rows: Mapping[str, Sequence[Number]]) -> str:
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    lines += [f"| {name} | " + " | ".join(map(_text, row)) + " |" for name, row in rows.items()]
    return "\n".join(lines)


def _text(value: Number) -> str:
    if value is None:
        return "n/a"
    # SSIM values differ in the fourth decimal; ratios of thousands need no decimals.
    return (
        f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}" if abs(value) < 100 else f"{value:.0f}"
    )
