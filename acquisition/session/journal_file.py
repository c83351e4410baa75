"""The journal file of an open session: lines are appended, flushed, and never changed."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Self, TypeVar

from pydantic import ValidationError

from acquisition._errors import DataError, StorageError
from acquisition.files.storage import append_durably, disk, open_binary, read_file, write_durably
from acquisition.session.journal import (
    GENESIS,
    REOPENED,
    EventLine,
    Journal,
    Line,
    StartLine,
    encode_line,
    parse_journal,
)
from rig.host import clock, filesystem
from rig.messages import validation_message

Clock = Callable[[], datetime]
AnyLine = TypeVar("AnyLine", bound=Line)


def utc_now() -> datetime:
    """Return the current time. It is for people; the order of lines is given by ``seq``."""
    return clock.utc_now()


class JournalFile:
    """An open journal: `begin` a new one or `resume` an existing one.

    Every line gets the next number, the time of the clock, and its hash in the chain.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self.path = path
        self._clock = clock
        self._seq = 0
        self._previous = GENESIS
        self._descriptor = -1
        self._unsure = False

    @classmethod
    def begin(cls, path: Path, toml_sha256: str, clock: Clock) -> Self:
        """Create the file with its first line. It appears with the complete line or not at all."""
        file = cls(path, clock)
        _, sealed, own = file._seal(StartLine, {"session_toml_sha256": toml_sha256})
        write_durably(path, sealed)
        file._open(own)
        return file

    @classmethod
    def resume(cls, path: Path, old: Journal, clock: Clock, details: Mapping[str, Any]) -> Self:
        """Continue after the intact lines of ``old`` with a ``reopened`` event.

        The file is replaced in one step: at every moment a torn last line is either still in the
        file or in the event's ``torn``.
        """
        file = cls(path, clock)
        file._seq, file._previous = len(old.lines), old.last_sha256
        values = {"event": REOPENED, "details": {**details, "torn": old.torn.decode("latin-1")}}
        _, sealed, own = file._seal(EventLine, values)
        write_durably(path, old.text + sealed)
        file._open(own)
        return file

    def append(self, kind: type[AnyLine], values: Mapping[str, Any]) -> AnyLine:
        """Append a line; when this returns, it is safe on disk.

        Raises
        ------
        DataError
            If the values are invalid for the line.
        StorageError
            If the disk refuses, or refused before: the end of the file is then unknown, and the
            session must be reopened.
        """
        self.check_open()
        line, sealed, own = self._seal(kind, values)
        # Cleared only when file and state agree again: after an error or interrupt in between, the
        # next line would be chained to the wrong one.
        self._unsure = True
        append_durably(self._descriptor, self.path, sealed)
        self._seq, self._previous = self._seq + 1, own
        self._unsure = False
        return line

    @property
    def sound(self) -> bool:
        """Whether the end of the file is known; if not, nothing more may be appended."""
        return not self._unsure

    def check_open(self) -> None:
        """Raise StorageError if no line can be appended."""
        if self._descriptor < 0:
            raise StorageError(f"{self.path}: is closed; reopen the session to continue")
        if self._unsure:
            raise StorageError(f"{self.path}: an earlier write was interrupted; reopen the session")

    def read_back(self) -> bytes:
        """Return the bytes of the file after checking that they are the bytes written."""
        self.check_open()
        with disk(self.path, "read"):
            data = read_file(self.path)
        journal = parse_journal(data)
        if journal.text != data or journal.last_sha256 != self._previous:
            raise StorageError(f"{self.path}: was changed by another program; verify the session")
        return data

    def close(self) -> None:
        """Close the file; harmless if repeated."""
        if self._descriptor >= 0:
            filesystem.close(self._descriptor)
            self._descriptor = -1

    def _seal(self, kind: type[AnyLine], values: Mapping[str, Any]) -> tuple[AnyLine, bytes, str]:
        time_utc = self._clock().isoformat(timespec="microseconds")
        try:
            line = kind(seq=self._seq, time_utc=time_utc, **values)
            return line, *encode_line(
                {"kind": line.kind, **line.model_dump(mode="json")}, self._previous
            )
        except ValidationError as error:
            reason = validation_message(error)
        except ValueError as error:
            reason = str(error)
        raise DataError(f"{self.path}: a line would be invalid: {reason}")

    def _open(self, own: str) -> None:
        with disk(self.path, "open"):
            self._descriptor = open_binary(self.path, os.O_WRONLY | os.O_APPEND)
        self._seq, self._previous = self._seq + 1, own
