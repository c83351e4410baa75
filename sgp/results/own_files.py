"""Files of earlier results that a command cannot read: what they are, and the remedy."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import acquisition
import rig
from sgp.results.hashes import sha256


@contextmanager
def own_files_named() -> Iterator[None]:
    """Note the files that a command reads; an error about one of a result names its command."""
    with rig.files.files_read() as read:
        try:
            yield
        except acquisition.DataError as error:
            for path in list(read):
                if path.name in str(error) and (remedy := _remedy(path)):
                    error.add_note(remedy)
            raise


def _remedy(path: Path) -> str | None:
    """Return what to do about a file that is not what its record says; None for other files."""
    # Late, because most commands end without such an error and need no pydantic.
    from sgp.results.record import records_of

    for _, record in records_of(path):
        known = record.files.get(path.name)
        if known is None:  # the record of an earlier program
            return f"it is a result of `{record.command}`: run this command again"
        if (fault := output_fault(path, known.bytes, known.sha256)) is not None:
            return f"it is a result of `{record.command}` and {fault}: run this command again"
    return None


def output_fault(path: Path, size: int, digest: str) -> str | None:
    """Return what is wrong with a file of a result, from its size and hash; None if nothing is."""
    try:
        if not os.path.isfile(path):  # opening a pipe would wait for its writer
            return "is not a file" if os.path.lexists(path) else "is missing"
        now = path.stat().st_size
        if now < size:
            return f"is cut short ({now} of {size} bytes)"
        return None if now == size and sha256(path) == digest else "was changed"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
