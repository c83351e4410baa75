"""The frames of a journal: what was recorded, and in which file it lies now."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from acquisition._session.journal import COMPACTED, EventLine, FrameLine, Journal
from acquisition._session.layout import FRAMES, JOURNAL, leaves
from acquisition._session.manifest import Manifest
from acquisition._session.session_frame import SessionFrame


def recorded_frames(
    folder: Path, manifest: Manifest, journal: Journal, problems: list[str]
) -> tuple[SessionFrame, ...]:
    """Return every frame that a journal tells of, where its file lies since its last compaction.

    Parameters
    ----------
    folder
        The session.
    manifest
        Its ``session.toml``.
    journal
        As far as it can be trusted.
    problems
        Lines that make no sense and files that lead out of the session are added, a line each.
    """
    frames: dict[int, SessionFrame] = {}
    # Nearly all files are no links, and then the folder alone decides: asking for each is slow.
    outside = leaves(folder / FRAMES, folder)
    for line in journal.lines:
        if isinstance(line, FrameLine):
            facts = (line.file, line.bytes, line.file_sha256)
            seq, of = line.seq, line
        elif isinstance(line, EventLine) and line.event == COMPACTED:
            compacted = _compacted(line, frames)
            if compacted is None:
                problems.append(f"{folder / JOURNAL}: line {line.seq + 1} compacts no frame")
                continue
            seq, facts = compacted
            of = frames[seq].line
        else:
            continue
        path = folder / facts[0]
        if outside or (path.is_symlink() and leaves(path, folder)):
            problems.append(f"{path}: is a link that leaves the session; put the file itself there")
        frames[seq] = SessionFrame(path, of, facts[1], facts[2], manifest.camera.shape)
    return tuple(frames.values())


def _compacted(
    line: EventLine, frames: dict[int, SessionFrame]
) -> tuple[int, tuple[str, int, str]] | None:
    """Return which frame an event compacted, and its file, size and hash since."""
    details = line.details
    seq = details.get("frame_seq")
    if not isinstance(seq, int) or seq not in frames:
        return None
    known = frames[seq].line
    try:
        changed = {
            "file": details["file"],
            "bytes": details["bytes"],
            "file_sha256": details["file_sha256"],
        }
        new = FrameLine.model_validate({**known.model_dump(), **changed})
    except (KeyError, ValidationError):
        return None
    return seq, (new.file, new.bytes, new.file_sha256)
