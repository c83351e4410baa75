"""Parts of pages that the code states: each replaces a comment of its page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from docs._extensions.figure_tables import figure_tables, record_keys, verdict_keys
from docs._extensions.notice_table import notice_table

if TYPE_CHECKING:
    from sphinx.application import Sphinx

# By page, and by the comment that is replaced.
PARTS = {
    "notices": {"notices": notice_table},
    "result-format": {
        "keys of a record": record_keys,
        "keys of a verdict": verdict_keys,
        "figures": figure_tables,
    },
}


def insert_parts(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the comments of a page."""
    for name, part in PARTS.get(page, {}).items():
        source[0] = source[0].replace(f"<!-- generated: {name} -->", part())


def pages_to_read(*_: object) -> list[str]:
    """Return the pages that must be read again, although their files are the same."""
    return [*PARTS]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the parts with Sphinx."""
    app.connect("source-read", insert_parts)
    app.connect("env-get-outdated", pages_to_read)
    return {"parallel_read_safe": True}
