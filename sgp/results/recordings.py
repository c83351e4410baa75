"""The recordings that a result was computed from, by their files and by the records of inputs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import acquisition
from sgp.results.metrics import RECORD_FORMAT
from sgp.results.result import json_table

# Options that name files of calibrations: these may be from recordings of other objects.
CALIBRATIONS: Final = ("lights", "camera", "flat", "sensor")
_MOST_RECORDS: Final = 40  # in a folder, as in `sgp.report.folder`
_TEXTS: Final = ("object", "operator", "place", "notes", "rights", "started_utc")


def recordings_of(
    inputs: Iterable[Path], calibrations: Iterable[Path] = ()
) -> list[acquisition.Identity]:
    """Return the identities of the recordings behind some inputs, each once.

    They are in ``session.toml`` or ``recording.json`` if these are inputs, else in the record of an
    earlier result that names an input as its output.

    Parameters
    ----------
    inputs
        Files that a command read.
    calibrations
        Files and folders among them, or around them, that do not count.
    """
    apart = {path.absolute() for path in calibrations}
    names: dict[Path, set[str]] = {}
    for path in (path.absolute() for path in inputs):
        if apart.isdisjoint((path, *path.parents)):
            names.setdefault(path.parent, set()).add(path.name)
    found = (one for folder, files in names.items() for one in _of_folder(folder, files))
    return list(dict.fromkeys(found))


def seen_in(source: acquisition.Source) -> dict[str, Any]:
    """Return the parameters of a record about its images: curve, and files that show the object."""
    images = [str(frame.path) for frame in source.frames if frame.role == "light"]
    return {"transfer": source.transfer.record(), "images": images}


def _of_folder(folder: Path, names: set[str]) -> Iterator[acquisition.Identity]:
    for name in sorted(names):
        identity = acquisition.source.read_identity(folder / name)
        if identity is not None:
            yield identity
    for file in sorted(folder.glob("*.json"))[:_MOST_RECORDS]:
        record = _record(file)
        outputs = record.get("outputs")
        made = outputs.values() if isinstance(outputs, dict) else ()
        if file.name in names or not names.isdisjoint(one for one in made if isinstance(one, str)):
            stated = record.get("recordings")
            yield from map(_identity, stated if isinstance(stated, list) else ())


def _record(path: Path) -> dict[str, Any]:
    """Return the content of a record; empty for other files.

    Validation by `sgp.results.record` would cost a quarter of a second for importing pydantic.
    """
    content = json_table(path)
    return content if content.get("format") == RECORD_FORMAT else {}


def _identity(stated: object) -> acquisition.Identity:
    """Return the identity that a record states, without values of other types."""
    values = stated if isinstance(stated, dict) else {}
    texts = {key: values[key] for key in _TEXTS if isinstance(values.get(key), str)}
    return acquisition.Identity(**texts, simulated=values.get("simulated") is True)


JOURNAL = "journal.jsonl"
# Lines that a compaction appends to a journal.
_EVENTS = ("reopened", "compacted")


def compacted_since(journal: Path, digest: str) -> acquisition.Session | None:
    """Return the session if a compaction is all that followed a journal with this SHA-256.

    The frames are the same then, in smaller files, whose sizes the journal states.
    """
    try:
        lines = journal.read_bytes().splitlines(keepends=True)
        session = acquisition.Session.open(journal.parent)
    except (OSError, acquisition.DataError):
        return None
    before = hashlib.sha256()
    for number, line in enumerate(lines, 1):
        before.update(line)
        if before.hexdigest() == digest:
            later = [json.loads(one).get("event") for one in lines[number:]]
            same = bool(later) and session.complete and set(later) <= set(_EVENTS)
            return session if same else None
    return None
