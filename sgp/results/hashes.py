"""Hashes of files: of inputs as they were used, and of the files of a result, which may differ."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import acquisition
import rig
from sgp.cli.console import shown

# `sgp report` makes pages again from the other files of a result.
_PAGE = ".html"
# Key of a record for the hash of the other keys.
SEAL = "record_sha256"
_digests: dict[tuple[Path, rig.files.FileStatus], str] = {}


def sha256(path: Path) -> str:
    """Return the hex digest of a file's bytes; an unchanged file is read only once.

    Raises
    ------
    OSError
        If it does not exist or cannot be read.
    DataError
        If another program is writing into it.
    """
    key = path.absolute(), rig.files.FileStatus.of(path.stat())
    if key not in _digests:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        if rig.files.FileStatus.of(path.stat()) != key[1]:
            raise _changed(path)
        _digests[key] = digest
    return _digests[key]


def input_hashes(files: Iterable[Path]) -> dict[str, str]:
    """Return the hashes of the inputs of a command by their paths, as the command used them.

    A command that takes long calls this before the work, too: a file whose time is another one at
    the end is then recognised as the same if its content is.

    Raises
    ------
    DataError
        If a file is missing, or was changed, replaced or removed after the command had opened it.
    """
    return {str(file): _input_hash(file) for file in shown("hashing the inputs", [*files])}


def _input_hash(path: Path) -> str:
    first = rig.files.status_when_read(path)
    try:
        digest = sha256(path)
        same = first in (None, rig.files.FileStatus.of(path.stat()))
    except FileNotFoundError:
        if first is None:
            raise acquisition.DataError(f"{path}: is missing: restore it") from None
        raise _changed(path, "removed") from None
    if same or (first is not None and _digests.get((path.absolute(), first)) == digest):
        return digest
    raise _changed(path)


def _changed(path: Path, what: str = "changed") -> acquisition.DataError:
    return acquisition.DataError(
        f"{path}: was {what} while this command used it: run the command again when no other "
        "program writes it"
    )


def seal(values: Mapping[str, Any]) -> str:
    """Return the hash of a record's values, as they are read back, without the seal itself."""
    rest = {key: value for key, value in values.items() if key != SEAL}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def output_files(paths: Iterable[Path]) -> Sequence[Path]:
    """Return the files of a result whose content is final: pages may be made again."""
    return [path for path in dict.fromkeys(paths) if path.suffix != _PAGE and path.is_file()]


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
