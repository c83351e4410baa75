"""Maps that fill band by band, and that a later process continues."""

from __future__ import annotations

import functools
import json
import os
import shutil
import stat
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from acquisition._errors import DataError, StorageError
from acquisition.files.band_file import BandFile
from acquisition.files.memory_maps import Form
from acquisition.files.storage import (
    append_durably,
    disk,
    lock_folder,
    make_folder,
    open_binary,
    part_path,
    sync_folder,
    write_durably,
)
from rig import UnreadableError, read_bounded
from rig.files import parse_json

# Of the folder: a folder of another layout is not continued.
_LAYOUT: Final = 2
_IDENTITY: Final = "identity.json"
_JOURNAL: Final = "journal.jsonl"
_DOING: Final = "computing these maps"

# First row, row after the last, and checksum of what was written.
_Written = tuple[int, int, int]


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
    >>> from acquisition.files import check_unfinished
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
    >>> from acquisition.files import is_unfinished
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
    >>> from acquisition.files import remove_unfinished
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


class DamagedMapsError(DataError):
    """Unfinished maps that were changed after they had been computed.

    Parameters
    ----------
    file
        What was changed.
    what
        How.
    """

    def __init__(self, file: Path, what: str) -> None:
        self.file, self.what = file, what
        super().__init__(f"{file}: {what}: remove {file.parent}")


class BandStore(Mapping[str, BandFile]):
    """File-backed maps of a long computation, with a journal of what is complete.

    The files are in a hidden folder. A process that is killed leaves them; the next one with the
    same identity continues after the last complete band. The journal has a checksum of what each
    band wrote, which is compared when a computation is continued. `remove` deletes the maps.

    Parameters
    ----------
    path
        Future result to which the maps belong; the hidden folder is next to it.
    identity
        What the values depend on, as JSON: parameters, hashes of inputs, software version.
    maps
        Shape ``(H, ...)`` and type of each map.
    replace
        Begin again if there are maps of another identity or damaged ones, which are otherwise
        refused.

    Raises
    ------
    OtherMapsError
        If there are maps of another identity.
    DamagedMapsError
        If rows that are complete were changed, cut off or deleted since.
    SessionInUseError
        If another process writes the same maps.
    StorageError
        If the disk refuses a file, or has too little space for the maps.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from acquisition.files import BandStore
    >>> form = {"albedo": ((6, 4), np.float32)}
    >>> with BandStore(Path("normals"), {"method": "ls"}, form) as maps:
    ...     maps["albedo"][0:3] = 1.0
    ...     maps.complete("solve", slice(0, 3))  # a kill after this loses nothing of rows 0 to 2
    ...     maps.missing("solve", 6), maps.remove()
    ([slice(3, 6, None)], None)
    """

    def __init__(
        self,
        path: Path,
        identity: Mapping[str, object],
        maps: Mapping[str, Form],
        *,
        replace: bool = False,
    ) -> None:
        self.folder = part_path(path)
        forms = {name: [list(shape), np.dtype(kind).name] for name, (shape, kind) in maps.items()}
        wanted = _as_json({**identity, "maps": forms})
        with disk(self.folder, "write"), suppress(FileNotFoundError):
            if not stat.S_ISDIR(self.folder.lstat().st_mode):  # a link is not followed
                self.folder.unlink()
        make_folder(self.folder)
        self._files: dict[str, BandFile] = {}
        self._others: list[BandFile] = []
        # Rows and checksums by map: of what the journal names, and of what it does not yet.
        self._known: dict[str, list[_Written]] = {name: [] for name in maps}
        self._fresh: dict[str, list[_Written]] = {name: [] for name in maps}
        self._descriptor = -1
        self._lock = lock_folder(self.folder, _DOING)
        try:
            found = _identity(self.folder / _IDENTITY)
            if found is not None and found != wanted and not replace:
                raise OtherMapsError(self.folder.parent, _differences(found, wanted))
            if found != wanted:
                self._empty(wanted)
            try:
                self._continue(maps)
            except DamagedMapsError:
                if not replace:
                    raise
                self.close_files()
                self._empty(wanted)
                self._continue(maps)
        except BaseException:
            self.close()
            raise

    def _continue(self, maps: Mapping[str, Form]) -> None:
        """Open the maps, and compare what is complete with the journal."""
        self.done: dict[str, list[slice]] = {}
        self._replay()
        if not self.done:
            self._check_space(maps)
        for name, (shape, kind) in maps.items():
            path = self.folder / f"{name}.raw"
            written = functools.partial(self._written, name)
            size = path.stat().st_size if path.is_file() else None
            self._files[name] = file = BandFile(path, shape, np.dtype(kind), written)
            if self._known[name] and size != file.nbytes:
                what = "was deleted" if size is None else "has another size"
                raise DamagedMapsError(path, f"{what} since a part of it was computed")
            for first, last, checksum in self._known[name]:
                if zlib.crc32(file[first:last].reshape(-1).view(np.uint8).data) != checksum:
                    what = f"rows {first} to {last - 1} were changed since they were computed"
                    raise DamagedMapsError(path, what)
        with disk(self.folder, "write"):
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
            self._descriptor = open_binary(self.folder / _JOURNAL, flags)
            sync_folder(self.folder)

    def __getitem__(self, name: str) -> BandFile:
        return self._files[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)

    def missing(self, step: str, units: int) -> list[slice]:
        """Return the units of a step that are not complete, in order."""
        gaps, at = [], 0
        for done in sorted(self.done.get(step, ()), key=lambda done: done.start):
            if done.start > at:
                gaps.append(slice(at, done.start))
            at = max(at, done.stop)
        return gaps if at >= units else [*gaps, slice(at, units)]

    @contextmanager
    def filling(self) -> Iterator[None]:
        """Keep what is complete after an error in the block; otherwise leave no maps."""
        try:
            yield
        except BaseException:
            self.close()
            if not self.done:
                self.remove()
                with suppress(OSError):
                    self.folder.parent.rmdir()  # if nothing else is in it
            raise

    def complete(self, step: str, units: slice) -> None:
        """Make all maps durable, then name units of a step in the journal.

        Raises
        ------
        StorageError
            If the disk refuses; the units then count as missing.
        """
        for file in self._files.values():
            file.sync()
        written = {name: parts for name, parts in self._fresh.items() if parts}
        self._append({"step": step, "units": [units.start, units.stop], "written": written})
        self._note(step, units, written)
        self._fresh = {name: [] for name in self._files}

    def _written(self, name: str, first: int, last: int, data: memoryview) -> None:
        """Note the checksum of rows that are about to be written."""
        kept = _apart(self._known[name], first, last)
        if len(kept) < len(self._known[name]):
            # After a kill the file may have either values.
            self._append({"replaced": [name, first, last]})
            self._known[name] = kept
        self._fresh[name] = [
            *_apart(self._fresh[name], first, last),
            (first, last, zlib.crc32(data)),
        ]

    def _append(self, line: Mapping[str, object]) -> None:
        data = f"{json.dumps(line)}\n".encode()
        append_durably(self._descriptor, self.folder / _JOURNAL, data)

    def _note(self, step: str, units: slice, written: Mapping[str, Sequence[_Written]]) -> None:
        self.done.setdefault(step, []).append(units)
        for name, parts in written.items():
            for first, last, checksum in parts:
                kept = _apart(self._known[name], first, last)
                self._known[name] = [*kept, (first, last, checksum)]

    def _replay(self) -> None:
        """Read the journal; a last line that was cut short is removed from it."""
        journal = self.folder / _JOURNAL
        self._known = {name: [] for name in self._known}
        try:
            data = read_bounded(journal)
        except FileNotFoundError:
            return
        except UnreadableError as error:
            raise DataError(f"{journal}: {error}") from error
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            with disk(journal, "repair"):
                os.truncate(journal, len(whole))
        for number, text in enumerate(whole.splitlines(), 1):
            try:
                line = parse_json(text)
                if "replaced" in line:
                    name, first, last = line["replaced"]
                    self._known[name] = _apart(self._known[name], first, last)
                else:
                    begin, end = line["units"]
                    if not 0 <= begin < end:
                        raise ValueError("no units")
                    self._note(line["step"], slice(begin, end), line["written"])
            except (UnreadableError, TypeError, ValueError, KeyError) as error:
                raise DamagedMapsError(journal, f"line {number} is damaged") from error

    def _empty(self, wanted: dict[str, Any]) -> None:
        """Begin with an empty folder."""
        with disk(self.folder, "write"):
            for old in self.folder.iterdir():
                old.unlink()
        write_durably(self.folder / _IDENTITY, f"{json.dumps(wanted)}\n".encode())

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

    def close_files(self) -> None:
        """Close the maps."""
        for file in (*self._files.values(), *self._others):
            file.close()

    def close(self) -> None:
        """Close the files, which stay; harmless if repeated."""
        self.close_files()
        for descriptor in (self._descriptor, self._lock):
            if descriptor >= 0:
                os.close(descriptor)
        self._descriptor = self._lock = -1

    def remove(self) -> None:
        """Delete the maps, after their result is complete."""
        for file in self._files.values():
            file.close()
        _remove(self.folder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _apart(parts: Sequence[_Written], first: int, last: int) -> list[_Written]:
    """Return the parts that have no row between two rows."""
    return [part for part in parts if part[1] <= first or part[0] >= last]


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
    found: dict[str, Any] = json.loads(json.dumps({**identity, "layout": _LAYOUT}))
    return found


def _amount(count: int) -> str:
    """Return bytes as text for people."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.1f} MB"


def _differences(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> Sequence[str]:
    names = [name for name in wanted if found.get(name) != wanted[name]]
    return names or [name for name in found if name not in wanted] or ["identity"]
