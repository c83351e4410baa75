"""Parts of pages that the code states: each replaces a comment of its page."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from docs._extensions.figure_tables import figure_tables, record_keys, verdict_keys
from docs._extensions.notice_table import notice_table

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).parents[2]
# Documents next to the folder of the site, which are pages of it.
ROOT_PAGES = {"README.md": "readme", "CONTRIBUTING.md": "contributing", "CHANGELOG.md": "changelog"}


def root_document(name: str) -> str:
    """Return a document of the root folder, with its links as they are on the site."""

    def link(found: re.Match[str]) -> str:
        target = found[1]
        if ":" not in target:
            if target in ROOT_PAGES:
                target = f"{ROOT_PAGES[target]}.md"
            elif target.startswith("docs/"):
                target = re.sub("/$", "/index.md", target.removeprefix("docs/"))
            else:
                target = f"../{target}"
        return f"]({target}"

    return re.sub(r"\]\(([^)#]+)", link, (ROOT / name).read_text(encoding="utf-8"))


# By page, and by the comment that is replaced.
PARTS = {
    **{page: {name: functools.partial(root_document, name)} for name, page in ROOT_PAGES.items()},
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
