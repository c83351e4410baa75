"""What lies where in the folder of a session."""

from __future__ import annotations

from pathlib import Path

from acquisition._storage import sha256_of

MANIFEST = "session.toml"
JOURNAL = "journal.jsonl"
COMPLETE = "COMPLETE"
FRAMES = "frames"
DERIVED = "derived"
# Not part of the recording, but read with it.
MASK = f"{DERIVED}/mask.png"
TRUE_MASK = f"{DERIVED}/truth/mask.png"
TRUE_NORMALS = f"{DERIVED}/truth/normals.exr"
# COMPLETE as it was before a compaction that has not ended: it tells a complete session whose
# compaction was cut off from a recording that never came to its end.
ASIDE = f"{DERIVED}/{COMPLETE}"
# Files of frames that have no line.
UNRECORDED = f"{DERIVED}/unrecorded"
# Files of frames that were found damaged.
SET_ASIDE_FOLDER = f"{DERIVED}/set_aside"

# Frames that are written at once: as many may be on disk before their lines are.
WRITERS = 2


def is_session(folder: Path) -> bool:
    """Tell a session from other folders."""
    return (folder / MANIFEST).is_file() or (folder / JOURNAL).is_file()


def completion_mark(journal: bytes) -> bytes:
    """Return what COMPLETE must hold; the form is that of sha256sum."""
    return f"{sha256_of(journal)}  {JOURNAL}\n".encode("ascii")


def leaves(path: Path, folder: Path) -> bool:
    """Tell whether a path leads out of a folder, links followed."""
    try:
        return not path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # links in a circle
        return True
