"""Sessions that `capture compact` has made smaller since a result was computed from them."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import acquisition

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
