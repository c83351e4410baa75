"""Layout of a session folder."""

from __future__ import annotations

from pathlib import Path

from acquisition.files.storage import sha256_of

MANIFEST = "session.toml"
JOURNAL = "journal.jsonl"
COMPLETE = "COMPLETE"
FRAMES = "frames"
DERIVED = "derived"
# Not part of the recording, but read together with it.
MASK = f"{DERIVED}/mask.png"
TRUE_MASK = f"{DERIVED}/truth/mask.png"
TRUE_NORMALS = f"{DERIVED}/truth/normals.exr"
# Copy of COMPLETE during a compaction. It distinguishes a complete session whose compaction was
# interrupted from a recording that was never completed.
ASIDE = f"{DERIVED}/{COMPLETE}"
# Frame files that have no journal line.
UNRECORDED = f"{DERIVED}/unrecorded"
# Damaged frame files.
SET_ASIDE_FOLDER = f"{DERIVED}/set_aside"

# Number of frames written in parallel, and so the most files that may lack a journal line after an
# interruption.
WRITERS = 2


def is_session(folder: Path) -> bool:
    """Return whether a folder is a session."""
    return (folder / MANIFEST).is_file() or (folder / JOURNAL).is_file()


def completion_mark(journal: bytes) -> bytes:
    """Return the content of COMPLETE, in the format of sha256sum."""
    return f"{sha256_of(journal)}  {JOURNAL}\n".encode("ascii")


def leaves(path: Path, folder: Path) -> bool:
    """Return whether a path leads out of a folder after following links."""
    try:
        return not path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # links in a circle
        return True
