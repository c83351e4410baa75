"""Which files a task reads, and whether they are those of an earlier run."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from sgp.results import JOURNAL, compacted_since, sha256

_COMPLETE = "COMPLETE"


class Stamp(NamedTuple):
    """A file at one time.

    Parameters
    ----------
    size
        Bytes.
    mtime_ns
        Time of the last modification in ns.
    sha256
        Hash of the content; empty if the file was not read.
    ctime_ns
        Time of the last change of the file itself in ns, which shows a change after which the time
        of modification was set back; 0 if an earlier program did not note it.
    """

    size: int
    mtime_ns: int
    sha256: str = ""
    ctime_ns: int = 0


def stamps(roots: Iterable[str | Path]) -> dict[str, Stamp]:
    """Return all files under files and folders, without reading them.

    The folder ``derived`` of a session does not count: it contains results.
    """
    found = {}
    for root in roots:
        for path in _below(Path(root)):
            status = path.stat()
            found[str(path)] = Stamp(
                status.st_size, status.st_mtime_ns, ctime_ns=status.st_ctime_ns
            )
    return found


def _below(root: Path) -> Iterator[Path]:
    if not root.is_dir():
        if root.is_file():
            yield root
        return
    is_session = (root / "session.toml").is_file()
    with os.scandir(root) as entries:
        names = sorted(entry.name for entry in entries)
    for name in names:
        if not (is_session and name == "derived"):
            yield from _below(root / name)


def difference(before: Mapping[str, Stamp], now: Mapping[str, Stamp]) -> str | None:
    """Return why files are not those of an earlier run, or None if they are the same.

    A file with another size or time is read again: with the same hash it is the same. A session
    that was compacted in between is the same, too.
    """
    before, now = dict(before), dict(now)
    for path in [path for path in now if Path(path).name == JOURNAL]:
        for same in list(_compacted(Path(path), before, now)):
            before.pop(same, None)
            now.pop(same, None)
    for path in now.keys() - before.keys():
        return f"{Path(path).name} is new"
    for path in before.keys() - now.keys():
        return f"{Path(path).name} was removed"
    for path, stamp in now.items():
        old = before[path]
        # Permissions and backups change the ctime of a file, too: of inputs, the hash decides.
        noted = old.ctime_ns if old.sha256 else 0
        if (old.size, old.mtime_ns) == (stamp.size, stamp.mtime_ns) and noted in (
            0,
            stamp.ctime_ns,
        ):
            continue
        if not old.sha256 or old.size != stamp.size or sha256(Path(path)) != old.sha256:
            return f"{Path(path).name} was changed"
    return None


def _compacted(
    journal: Path, before: Mapping[str, Stamp], now: Mapping[str, Stamp]
) -> Iterator[str]:
    """Yield files that a compaction of their session has changed, but not their content.

    They are not read: the journal, of which COMPLETE has the hash, states their sizes.
    """
    old = before.get(str(journal))
    if old is None or not now[str(journal)].size > old.size:
        return
    session = compacted_since(journal, old.sha256)
    if session is None:
        return
    yield from (str(journal), str(journal.parent / _COMPLETE))
    for frame in session.recorded:
        original, path = str(journal.parent / frame.line.file), str(frame.path)
        found = now.get(path)
        if original in before and found is not None and found.size == frame.bytes:
            yield from (original, path)
