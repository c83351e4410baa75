"""Parts of pages that the code states: each replaces a comment of its page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from docs._extensions.figure_tables import figure_tables, record_keys, verdict_keys
from docs._extensions.notice_table import notice_table

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PARTS = {
    "<!-- generated: notices -->": notice_table,
    "<!-- generated: keys of a record -->": record_keys,
    "<!-- generated: keys of a verdict -->": verdict_keys,
    "<!-- generated: figures -->": figure_tables,
}


def insert_parts(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the comments of a page."""
    for comment, part in PARTS.items():
        if comment in source[0]:
            source[0] = source[0].replace(comment, part())


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the parts with Sphinx."""
    app.connect("source-read", insert_parts)
    return {"parallel_read_safe": True}
