"""What a table of the comparison is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

Number = float | None


@dataclass(frozen=True)
class Table:
    """Figures found here, and those that the paper prints.

    Parameters
    ----------
    key
        Its name in the JSON.
    title
        What it tells, units in the row names.
    columns, rows
        What was found: a row of one figure per column; None where there is none.
    paper_columns, paper_rows
        What the paper prints.
    note
        Why the two must not be read as one.
    """

    key: str
    title: str
    columns: tuple[str, ...]
    rows: Mapping[str, Sequence[Number]]
    paper_columns: tuple[str, ...]
    paper_rows: Mapping[str, Sequence[Number]]
    note: str


def flattened(table: Mapping[str, Mapping[str, Sequence[Number]]]) -> dict[str, Sequence[Number]]:
    """Return rows of rows as rows: ``quantity, method``."""
    return {
        f"{name}, {method}": row for name, rows in table.items() for method, row in rows.items()
    }


def markdown(table: Table) -> str:
    """Return a table as Markdown: what was found, then what the paper prints."""
    return "\n\n".join(
        [
            f"## {table.title}",
            "Here:",
            _grid(table.columns, table.rows),
            "The paper:",
            _grid(table.paper_columns, table.paper_rows),
            table.note,
        ]
    )


def _grid(columns: tuple[str, ...], rows: Mapping[str, Sequence[Number]]) -> str:
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    lines += [f"| {name} | " + " | ".join(map(_text, row)) + " |" for name, row in rows.items()]
    return "\n".join(lines)


def _text(value: Number) -> str:
    if value is None:
        return "n/a"
    # SSIM needs four decimals to differ; a ratio of thousands none.
    return (
        f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}" if abs(value) < 100 else f"{value:.0f}"
    )
