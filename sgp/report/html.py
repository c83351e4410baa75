"""HTML from Python values: the only place that writes markup, and that escapes texts."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable
from typing import Any, Final

from sgp.cli.terminal import printable

_VOID: Final = frozenset({"img", "br", "input", "meta", "link"})


class Html(str):
    """Markup: `tag` and `joined` insert it as it is, and escape all other texts."""

    __slots__ = ()


def text(content: str) -> Html:
    """Escape a text for HTML; control characters and direction marks become visible escapes."""
    return Html(html.escape(printable(content), quote=True))


def tag(name: str, *children: str | Iterable[str], **attributes: str | float | None) -> Html:
    """Return an element; children that are not `Html` are texts.

    Underscores in the names of attributes are hyphens; a final one is dropped (``class_``). An
    attribute of None is left out, an empty one has no value.
    """
    named = (
        Html(
            f" {key.rstrip('_').replace('_', '-')}"
            + (f'="{text(str(value))}"' if value != "" else "")
        )
        for key, value in attributes.items()
        if value is not None
    )
    opening = f"<{name}{''.join(named)}>"
    if name in _VOID:
        return Html(opening)
    return Html(f"{opening}{joined(*children)}</{name}>")


def joined(*children: str | Iterable[str]) -> Html:
    """Return children one after another; those that are not `Html` are texts."""
    parts = []
    for child in children:
        if isinstance(child, Html):
            parts.append(child)
        elif isinstance(child, str):
            parts.append(text(child))
        else:
            parts.append(joined(*child))
    return Html("".join(parts))


def details(title: str, table: Html) -> Html:
    """Return a table that is folded under its title."""
    return tag("details", tag("summary", title), tag("div", table, class_="scroll"))


def script_json(value: Any) -> Html:
    """Return JSON for a ``script`` element, which ends at no text within it."""
    content = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for sign in "<>&":
        content = content.replace(sign, f"\\u{ord(sign):04x}")
    return Html(content)
