"""Whether the inputs of a result are still the files that its records name."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import rig
from sgp._hashes import sha256
from sgp._report.folder import ResultFolder

State = Literal["same", "changed", "unlisted"]


class Inputs:
    """The inputs of the records of a folder, with the hashes that they had."""

    def __init__(self, folder: ResultFolder) -> None:
        self._hashes: dict[Path, str] = {}
        for record in folder.records.values():
            for name, digest in record.inputs.items():
                self._hashes.setdefault(folder.located(name).absolute(), digest)

    def state(self, path: Path) -> State:
        """Return whether a file has the hash of the records; one that is gone has changed."""
        digest = self._hashes.get(path.absolute())
        if digest is None:
            return "unlisted"
        try:
            return "same" if sha256(path) == digest else "changed"
        except OSError:
            return "changed"

    def below(self, path: Path) -> list[Path]:
        """Return the inputs that are this file, or in this folder."""
        place = path.absolute()
        return [file for file in self._hashes if file == place or place in file.parents]


def changed_notice(files: Iterable[Path], what: str) -> rig.Notice:
    """Return the notice about inputs that changed; ``what`` says what is not shown."""
    first, *others = files
    more = f" and {rig.pluralize(len(others), 'other file')}" if others else ""
    verb = "have" if others else "has"
    text = f"{first}{more} {verb} changed since the result was computed: {what}"
    return rig.Notice("input-changed", text)
