"""What the results of a page are of: objects, circumstances and rights of their recordings."""

from __future__ import annotations

from collections.abc import Iterable
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


def identity_list(identity: acquisition.Identity) -> Html:
    """Return the texts of a recording that are not empty, with their terms."""
    texts = ((term, str(getattr(identity, key))) for key, term in _TERMS.items())
    rows = ((tag("dt", term), tag("dd", _lines(text))) for term, text in texts if text)
    origin = (tag("dt", "Origin"), tag("dd", "SIMULATED")) if identity.simulated else ()
    return tag("dl", origin, (cell for row in rows for cell in row), class_="identity")


def _lines(text: str) -> list[str]:
    """Return the lines of a text with breaks between them."""
    return [part for line in text.splitlines() for part in (line, tag("br"))][:-1]


def marked(title: str, identities: Iterable[acquisition.Identity]) -> str:
    """Return a title that says whether a recording is simulated."""
    return f"SIMULATED: {title}" if any(one.simulated for one in identities) else title
