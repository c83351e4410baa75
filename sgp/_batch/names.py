"""Names of sources in a batch, which stay the same when sources are added."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from sgp._options import distinct

# Files and folders that a batch itself writes.
_TAKEN = ("state", "thumbnails", "batch.csv", "batch.json", "index.html")


def names_of(sources: Sequence[Path], known: Mapping[str, str]) -> dict[str, Path]:
    """Return a name for each source: its last part, with those of its folders where needed.

    Parameters
    ----------
    sources
        The sources.
    known
        Sources of earlier runs by their names, which they keep.

    Raises
    ------
    UsageError
        If a source is given twice.
    """
    first = distinct(sources)
    kept = {source: name for name, source in known.items()}
    used = {name.casefold() for name in (*_TAKEN, *known)}
    named = {}
    for place in first:
        name = kept.get(str(place)) or _new_name(place, used)
        used.add(name.casefold())
        named[name] = place
    return named


def _new_name(place: Path, used: set[str]) -> str:
    parts = list(place.parts[1:]) or ["source"]
    for count in range(1, len(parts) + 1):
        name = "-".join(parts[-count:])
        if name.casefold() not in used and not name.startswith("."):
            return name
    number = 2
    while f"{parts[-1]}-{number}".casefold() in used:
        number += 1
    return f"{parts[-1]}-{number}"
