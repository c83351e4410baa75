"""What a result folder contains: its records, and its maps by name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Literal

import acquisition
import processing
import rig
from sgp.results import ResultRecord, is_record, read_record, sha256

# Of the folders of `sgp run`; the first one that has a map counts.
_STAGES: Final = ("", "normals", "detail", "surface", "curvature")
_PIPELINE: Final = ("normals", "detail", "surface")
_MOST_RECORDS: Final = 40


@dataclass(frozen=True, eq=False)
class ResultFolder:
    """A result folder, as far as it can be read.

    Parameters
    ----------
    path
        The folder.
    records
        Records by their path relative to the folder; those that a measurement of roughness names as
        its inputs follow.
    notices
        Records that could not be read, and stages and maps that are missing.
    """

    path: Path
    records: Mapping[str, ResultRecord]
    notices: list[rig.Notice] = field(default_factory=list)

    def file(self, name: str) -> Path | None:
        """Return the file of this name, of the folder or of its stages."""
        paths = (self.path / stage / name for stage in _STAGES)
        return next((path for path in paths if path.is_file()), None)

    def record_of(self, path: Path) -> ResultRecord | None:
        """Return the record that lists a file as an output."""
        for name, record in self.records.items():
            folder = (self.path / name).parent
            if path.parent == folder and path.name in record.outputs.values():
                return record
        return None

    @property
    def main(self) -> ResultRecord | None:
        """The record of the complete folder: the one with the fewest folders in its path."""
        names = sorted(self.records, key=lambda name: (name.count("/"), name))
        return self.records[names[0]] if names else None

    @property
    def roughness(self) -> ResultRecord | None:
        """The record of the parameters of areas, profiles and steps, if the folder has one."""
        record = self.records.get("roughness.json")
        return record if record is not None and record.command == "sgp roughness" else None

    @property
    def verdict(self) -> tuple[processing.checks.Answer, processing.checks.Verdict] | None:
        """The verdict of the first record that has one: as it was written, and with its causes."""
        for record in self.records.values():
            judged = record.judged
            if record.verdict is not None and judged is not None:
                return record.verdict, judged
        return None

    @property
    def source(self) -> Path | None:
        """The recording that the result was computed from, if a record names one."""
        for record in self.records.values():
            # Its source is another normal map.
            if record.command == "sgp detail transfer":
                continue
            named = record.parameters.get("source")
            if isinstance(named, str):
                return self.located(named)
        return None

    @property
    def recordings(self) -> tuple[acquisition.Identity, ...]:
        """What the recordings of all records were of, each once."""
        records = self.records.values()
        return tuple(dict.fromkeys(one for record in records for one in record.recordings))

    def located(self, named: str) -> Path:
        """Return where a path of the records is.

        A relative one begins at the folder in which the command ran: the current one, or one that
        contains the result.
        """
        path = Path(named)
        starts = [Path(), *self.path.absolute().parents]
        return next((start / path for start in starts if (start / path).exists()), path)

    def parameter(self, name: str) -> object:
        """Return the first parameter of this name that is not None."""
        values = (record.parameters.get(name) for record in self.records.values())
        return next((value for value in values if value is not None), None)


# Of the notices about files that cannot be read.
_CODES: Final[dict[str, str]] = {
    "record": "record-unreadable",
    "map": "map-unreadable",
    "recording": "recording-unreadable",
}


@contextmanager
def noted(
    notices: list[rig.Notice], kind: str, what: str = "", *, severity: rig.Severity = "warning"
) -> Iterator[None]:
    """Note the error of a file of some kind that cannot be read; ``what`` is before its text."""
    try:
        yield
    except (acquisition.DataError, acquisition.MissingPathError) as error:
        notices.append(rig.Notice(_CODES[kind], f"{what}{error}", severity=severity))


def read_folder(path: Path) -> ResultFolder:
    """Read the records of a result folder.

    Raises
    ------
    DataError
        If the path is a file.
    """
    if not path.is_dir():
        raise acquisition.DataError(f"{path}: is a file: give the folder of a result")
    records: dict[str, ResultRecord] = {}
    notices: list[rig.Notice] = []
    for stage in _STAGES:
        for file in sorted((path / stage).glob("*.json"))[:_MOST_RECORDS]:
            if not is_record(file):
                continue
            with noted(notices, "record", severity="error"):
                records[str(file.relative_to(path))] = read_record(file)
    folder = ResultFolder(path, records, notices)
    notices += [*_unfinished(folder), *_missing(folder)]
    return replace(folder, records=records | _measured(folder))


def _measured(folder: ResultFolder) -> dict[str, ResultRecord]:
    """Return the records of the surface and the normals that were measured, if unchanged."""
    if folder.roughness is None:
        return {}
    inputs, found = Inputs(folder), {}
    for path in (folder.located(name) for name in folder.roughness.inputs):
        if path.suffix != ".json":
            continue
        if inputs.state(path) != "same":
            continue
        with noted(folder.notices, "record"):
            found[str(path)] = read_record(path)
    return found


def _unfinished(folder: ResultFolder) -> list[rig.Notice]:
    """Return what is missing of a folder of several stages."""
    present = [stage for stage in _PIPELINE if (folder.path / stage).is_dir()]
    if not present:
        return []
    missing = [stage for stage in _PIPELINE if stage not in present]
    begun = [one for one in present if not (folder.path / one / f"{one}.json").exists()]
    texts = [
        *(f"{stage}: is missing" for stage in missing),
        *(
            f"{stage}: has no record: the command that writes it has not finished"
            for stage in begun
        ),
    ]
    return [rig.Notice("result-unfinished", text) for text in texts]


def _missing(folder: ResultFolder) -> list[rig.Notice]:
    """Return the maps that records name and that are gone."""
    notices = []
    for name, record in folder.records.items():
        place = (folder.path / name).parent
        maps = (output for output in record.outputs.values() if output.endswith(".exr"))
        if gone := sorted(one for one in maps if not (place / one).exists()):
            text = f"{folder.path / name}: these maps are missing: {', '.join(gone)}"
            notices.append(rig.Notice("map-missing", text))
    return notices


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
