"""Maps that fill band by band, and that a later process continues."""

from __future__ import annotations

import json
import os
import shutil
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from acquisition._bands.map_rows import BandFile
from acquisition._errors import DataError, StorageError
from acquisition._storage import (
    append_durably,
    disk,
    lock_folder,
    make_folder,
    open_binary,
    part_path,
    sync_folder,
    write_durably,
)
from rig import UnreadableError, parse_json, read_bounded

_IDENTITY: Final = "identity.json"
_JOURNAL: Final = "journal.jsonl"
_DOING: Final = "computing these maps"

Form = tuple[tuple[int, ...], type[np.generic]]


class OtherMapsError(DataError):
    """Unfinished maps of another identity.

    Parameters
    ----------
    folder
        Folder that contains them.
    other
        What differs.
    """

    def __init__(self, folder: Path, other: Sequence[str]) -> None:
        self.folder, self.other = folder, ", ".join(other)
        super().__init__(
            f"{folder}: contains unfinished maps of a computation that differs in {self.other}: "
            "repeat that one, replace its maps, or choose another folder"
        )


def check_unfinished(path: Path, identity: Mapping[str, object]) -> None:
    """Refuse unfinished maps of another identity before any work, by `OtherMapsError`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition import check_unfinished
    >>> check_unfinished(Path("normals"), {"method": "ls"})
    """
    found, wanted = _identity(part_path(path) / _IDENTITY), _as_json(identity)
    if found is not None and {**found, "maps": None} != {**wanted, "maps": None}:
        raise OtherMapsError(path.parent, _differences(found, wanted))


def is_unfinished(path: Path) -> bool:
    """Return whether a process that ended early left maps of this result, which can be continued.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition import is_unfinished
    >>> is_unfinished(Path("normals"))
    False
    """
    return (part_path(path) / _IDENTITY).is_file()


def remove_unfinished(path: Path) -> None:
    """Remove unfinished maps, if there are any, of a result that was computed without them.

    Raises
    ------
    SessionInUseError
        If another process writes them.
    StorageError
        If the disk refuses.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition import remove_unfinished
    >>> remove_unfinished(Path("normals"))
    """
    folder = part_path(path)
    if not folder.is_dir():
        return
    lock = lock_folder(folder, _DOING)
    try:
        _remove(folder)
    finally:
        os.close(lock)


class BandStore(Mapping[str, BandFile]):
    """File-backed maps of a long computation, with a journal of the rows that are complete.

    The files are in a hidden folder. A process that is killed leaves them; the next one with the
    same identity continues after the last complete band. `remove` deletes them.

    Parameters
    ----------
    path
        Future result to which the maps belong; the hidden folder is next to it.
    identity
        What the values depend on, as JSON: parameters, hashes of inputs, software version.
    maps
        Shape ``(H, ...)`` and type of each map, all with the same H unless there are `units`.
    replace
        Begin again if there are maps of another identity, which are otherwise refused.
    units
        What the journal counts instead of rows, for a computation in several steps.

    Raises
    ------
    OtherMapsError
        If there are maps of another identity.
    SessionInUseError
        If another process writes the same maps.
    StorageError
        If the disk refuses a file, or has too little space for the maps.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from acquisition import BandStore
    >>> form = {"albedo": ((6, 4), np.float32)}
    >>> with BandStore(Path("normals"), {"method": "ls"}, form) as maps:
    ...     maps["albedo"][0:3] = 1.0
    ...     maps.complete(slice(0, 3))  # a kill after this loses nothing of rows 0 to 2
    ...     maps.missing(), maps.remove()
    ([slice(3, 6, None)], None)
    """

    def __init__(
        self,
        path: Path,
        identity: Mapping[str, object],
        maps: Mapping[str, Form],
        *,
        replace: bool = False,
        units: int | None = None,
    ) -> None:
        self.folder = part_path(path)
        self._height = next(iter(maps.values()))[0][0] if units is None else units
        forms = {name: [list(shape), np.dtype(kind).name] for name, (shape, kind) in maps.items()}
        wanted = _as_json({**identity, "maps": forms})
        with disk(self.folder, "write"), suppress(FileNotFoundError):
            if not stat.S_ISDIR(self.folder.lstat().st_mode):  # a link is not followed
                self.folder.unlink()
        make_folder(self.folder)
        self._files: dict[str, BandFile] = {}
        self._others: list[BandFile] = []
        self._journal = -1
        self._lock = lock_folder(self.folder, _DOING)
        try:
            self._claim(wanted, replace=replace)
            self.done = _rows_done(self.folder / _JOURNAL, self._height)
            if not self.done:
                self._check_space(maps)
            for name, (shape, kind) in maps.items():
                file = self.folder / f"{name}.raw"
                self._files[name] = BandFile(file, shape, np.dtype(kind))
            with disk(self.folder, "write"):
                self._journal = open_binary(
                    self.folder / _JOURNAL, os.O_WRONLY | os.O_CREAT | os.O_APPEND
                )
                sync_folder(self.folder)
        except BaseException:
            self.close()
            raise

    def __getitem__(self, name: str) -> BandFile:
        return self._files[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)

    def missing(self) -> list[slice]:
        """Return the rows that are not complete, in order."""
        gaps, at = [], 0
        for rows in sorted(self.done, key=lambda rows: rows.start):
            if rows.start > at:
                gaps.append(slice(at, rows.start))
            at = max(at, rows.stop)
        return gaps if at >= self._height else [*gaps, slice(at, self._height)]

    def missing_bands(self, count: int, part: slice | None = None) -> list[slice]:
        """Return the rows that are not complete, in bands of at most `count`.

        ``part`` is the range of a step among the units that the journal counts; its bands begin at
        0. By default, it is everything.
        """
        first, last = (0, self._height) if part is None else (part.start, part.stop)
        bands = []
        for gap in self.missing():
            begin, end = max(gap.start, first) - first, min(gap.stop, last) - first
            bands += [slice(top, min(top + count, end)) for top in range(begin, end, count)]
        return bands

    @contextmanager
    def filling(self) -> Iterator[None]:
        """Keep what is complete after an error in the block, as `abandon` does."""
        try:
            yield
        except BaseException:
            self.abandon()
            raise

    def complete(self, rows: slice) -> None:
        """Make rows of all maps durable, then name them in the journal.

        Raises
        ------
        StorageError
            If the disk refuses; the rows then count as missing.
        """
        for file in self._files.values():
            file.sync()
        line = json.dumps([rows.start, rows.stop])
        append_durably(self._journal, self.folder / _JOURNAL, f"{line}\n".encode())
        self.done.append(rows)

    def _claim(self, wanted: dict[str, Any], *, replace: bool) -> None:
        """Keep the maps of the same identity, remove those of another one."""
        file = self.folder / _IDENTITY
        found = _identity(file)
        if found == wanted:
            return
        if found is not None and not replace:
            raise OtherMapsError(self.folder.parent, _differences(found, wanted))
        with disk(self.folder, "write"):
            for old in self.folder.iterdir():
                old.unlink()
        write_durably(file, f"{json.dumps(wanted)}\n".encode())

    def _check_space(self, maps: Mapping[str, Form]) -> None:
        needed = sum(int(np.prod(shape)) * np.dtype(kind).itemsize for shape, kind in maps.values())
        with disk(self.folder, "write"):
            free = shutil.disk_usage(self.folder).free
        if free < needed:
            raise StorageError(
                f"{self.folder.parent}: the maps need {_amount(needed)} of disk while they are "
                f"computed, {_amount(free)} are free: free space, or choose another disk"
            )

    def close_with(self, file: BandFile) -> None:
        """Close another file in the folder, such as that of an input, together with the maps."""
        self._others.append(file)

    def close(self) -> None:
        """Close the files, which stay; harmless if repeated."""
        for file in (*self._files.values(), *self._others):
            file.close()
        for descriptor in (self._journal, self._lock):
            if descriptor >= 0:
                os.close(descriptor)
        self._journal = self._lock = -1

    def abandon(self) -> None:
        """Close the files after an error: maps of which no row is complete are deleted."""
        self.close()
        if not self.done:
            self.remove()
            with suppress(OSError):
                self.folder.parent.rmdir()  # if nothing else is in it

    def remove(self) -> None:
        """Delete the maps, after their result is complete."""
        for file in self._files.values():
            file.close()
        _remove(self.folder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _remove(folder: Path) -> None:
    """Delete maps; what a kill leaves of them has no identity, and is not continued."""
    with disk(folder, "remove"), suppress(FileNotFoundError):
        (folder / _IDENTITY).unlink(missing_ok=True)
        shutil.rmtree(folder)


def _identity(file: Path) -> dict[str, Any] | None:
    """Return the identity of maps, or None without any."""
    try:
        found = parse_json(read_bounded(file))
    except FileNotFoundError:
        return None
    except UnreadableError:
        return {}
    return found if isinstance(found, dict) else {}


def _as_json(identity: Mapping[str, object]) -> dict[str, Any]:
    """Return an identity as it is read back: tuples become lists."""
    found: dict[str, Any] = json.loads(json.dumps(identity))
    return found


def _amount(count: int) -> str:
    """Return bytes as text for people."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.1f} MB"


def _differences(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> Sequence[str]:
    names = [name for name in wanted if found.get(name) != wanted[name]]
    return names or [name for name in found if name not in wanted] or ["identity"]


def _rows_done(journal: Path, height: int) -> list[slice]:
    """Return the rows that a journal names; a last line that was cut short is removed from it."""
    try:
        data = read_bounded(journal)
    except FileNotFoundError:
        return []
    except UnreadableError as error:
        raise DataError(f"{journal}: {error}") from error
    whole = data[: data.rfind(b"\n") + 1]
    if len(whole) < len(data):
        with disk(journal, "repair"):
            os.truncate(journal, len(whole))
    done = []
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            first, last = parse_json(line)
            valid = 0 <= first < last <= height
        except (UnreadableError, TypeError, ValueError):
            valid = False
        if not valid:
            raise DataError(f"{journal}: line {number} is damaged: remove {journal.parent}")
        done.append(slice(first, last))
    return done
