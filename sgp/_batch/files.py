"""Which files a task reads, and whether they are those of an earlier run."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from sgp._output import sha256


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
    """

    size: int
    mtime_ns: int
    sha256: str = ""


def stamps(roots: Iterable[str | Path]) -> dict[str, Stamp]:
    """Return all files under files and folders, without reading them.

    The folder ``derived`` of a session does not count: it contains results.
    """
    found = {}
    for root in roots:
        for path in _below(Path(root)):
            status = path.stat()
            found[str(path)] = Stamp(status.st_size, status.st_mtime_ns)
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

    A file with another size or time is read again: with the same hash it is the same.
    """
    for path in now.keys() - before.keys():
        return f"{Path(path).name} is new"
    for path in before.keys() - now.keys():
        return f"{Path(path).name} was removed"
    for path, stamp in now.items():
        old = before[path]
        if (old.size, old.mtime_ns) == (stamp.size, stamp.mtime_ns):
            continue
        if not old.sha256 or old.size != stamp.size or sha256(Path(path)) != old.sha256:
            return f"{Path(path).name} was changed"
    return None
