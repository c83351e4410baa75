"""What the results of a page are of: objects, circumstances and rights of their recordings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import acquisition
from sgp._report.html import Html, tag

_TERMS: Final = {
    "object": "Object",
    "operator": "Operator",
    "place": "Place",
    "started_utc": "Recorded",
    "notes": "Notes",
    "rights": "Rights",
}


def identity_list(identity: acquisition.Identity, results: Sequence[str] = ()) -> Html:
    """Return the texts of a recording that are not empty, with their terms.

    ``results`` are the names of the results, if the page has others.
    """
    texts = ((term, str(getattr(identity, key))) for key, term in _TERMS.items())
    rows = ((tag("dt", term), tag("dd", _lines(text))) for term, text in texts if text)
    origin = (tag("dt", "Origin"), tag("dd", "SIMULATED")) if identity.simulated else ()
    named = (tag("dt", "Results"), tag("dd", ", ".join(results))) if results else ()
    return tag("dl", named, origin, (cell for row in rows for cell in row), class_="identity")


def _lines(text: str) -> list[str]:
    """Return the lines of a text with breaks between them."""
    return [part for line in text.splitlines() for part in (line, tag("br"))][:-1]


def marked(title: str, identities: Iterable[acquisition.Identity]) -> str:
    """Return a title that says whether a recording is simulated."""
    return f"SIMULATED: {title}" if any(one.simulated for one in identities) else title
