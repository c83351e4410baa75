"""Whether results are what their records state, and their inputs still the files of then."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import acquisition
import rig
from sgp.cli.console import shown
from sgp.cli.exit import UsageError
from sgp.results.hashes import output_fault, seal, sha256
from sgp.results.record import OutputFile, ResultRecord, is_record, read_record
from sgp.results.recordings import JOURNAL, compacted_since

_IMAGES = (".png", ".exr")


@dataclass(frozen=True)
class _Statement:
    """What a record, or a file with its provenance such as lights.json, states."""

    path: Path
    command: str
    inputs: Mapping[str, str]
    outputs: Mapping[str, OutputFile | None] = field(default_factory=dict)


@dataclass
class Verification:
    """What was compared, and what was found.

    Parameters
    ----------
    records
        Records, and files with their provenance.
    files, inputs
        Files of the results, and inputs that were compared.
    inputs_missing
        Inputs that are no longer there.
    notices
        What was found; faults have the severity ``error``.
    """

    records: int = 0
    files: int = 0
    inputs: int = 0
    inputs_missing: int = 0
    notices: list[rig.Notice] = field(default_factory=list)

    @property
    def faults(self) -> int:
        """Number of faults."""
        return sum(notice.severity == "error" for notice in self.notices)


def verify_results(roots: Sequence[Path]) -> Verification:
    """Compare results with their records, in folders of any depth or single files.

    Raises
    ------
    UsageError
        If a path has no record.
    """
    found = Verification()
    outputs: dict[tuple[Path, OutputFile | None], str] = {}
    inputs: dict[tuple[str, str], Path] = {}
    for root in roots:
        before = found.records + found.faults
        for one in _statements(root, found):
            found.records += 1
            for name, known in one.outputs.items():
                # The record of a complete run and that of a stage may state the same file.
                outputs.setdefault((one.path.parent / name, known), one.command)
            for name, digest in one.inputs.items():
                inputs.setdefault((name, digest), one.path)
        if found.records + found.faults == before:
            raise UsageError(
                f"{root}: has no record of a result, as if the command that writes it was stopped: "
                "run it again, or give a folder that sgp has written (`capture verify` checks "
                "recordings)"
            )
    _check_outputs(outputs, found)
    _check_inputs(inputs, found)
    return found


def _statements(root: Path, found: Verification) -> Iterator[_Statement]:
    for path in _json_files(root):
        try:
            if is_record(path):
                record = read_record(path)
                _check_seal(path, record, found)
                whole = path.parent.parent / "summary.json"
                if record.command == "sgp run" and path.name != whole.name and not whole.exists():
                    text = "no summary.json: `sgp run` was stopped, or stages were copied"
                    notice = rig.Notice("result-unfinished", text, str(whole.parent))
                    found.notices += [] if notice in found.notices else [notice]
                files = dict.fromkeys(record.outputs.values()) | record.files
                yield _Statement(path, record.command, record.inputs, files)
            elif (made_by := _provenance(path)) is not None:
                yield _Statement(path, *made_by)
        except (acquisition.DataError, acquisition.MissingPathError) as error:
            found.notices.append(rig.Notice("record-unreadable", str(error), severity="error"))


def _check_seal(path: Path, record: ResultRecord, found: Verification) -> None:
    known = record.record_sha256
    if known is not None and seal(rig.files.parse_json(rig.read_bounded(path))) != known:
        text = f"was changed: it is the record of `{record.command}`: run this command again"
        found.notices.append(rig.Notice("output-damaged", text, str(path), "error"))


def _json_files(root: Path) -> Iterator[Path]:
    if root.is_file():
        yield from [root] if root.suffix == ".json" else []
    visited = set()
    for folder, names, files in os.walk(root, followlinks=True):
        if (place := os.path.realpath(folder)) in visited:  # links may lead round in a circle
            names.clear()
            continue
        visited.add(place)
        names[:] = sorted(filter(_is_shown, names))
        yield from (
            Path(folder, name)
            for name in sorted(filter(_is_shown, files))
            if name.endswith(".json")
        )


def _is_shown(name: str) -> bool:
    return not name.startswith(".")  # for instance ._normals.json, which macOS adds on some disks


def _provenance(path: Path) -> tuple[str, dict[str, str]] | None:
    """Return the command and the input hashes of a file such as lights.json, if it has them."""
    try:
        content = rig.files.parse_json(rig.read_bounded(path))
    except (FileNotFoundError, rig.UnreadableError) as error:
        raise acquisition.DataError(f"{path}: {error}") from error
    made_by = content.get("provenance") if isinstance(content, dict) else None
    if not isinstance(made_by, dict) or not isinstance(inputs := made_by.get("inputs"), dict):
        return None
    texts = {name: digest for name, digest in inputs.items() if isinstance(digest, str)}
    return str(made_by.get("command")), texts


def _check_outputs(
    outputs: Mapping[tuple[Path, OutputFile | None], str], found: Verification
) -> None:
    without = 0
    for (path, known), command in shown("checking the results", [*outputs.items()]):
        if known is None:
            without += path.suffix in _IMAGES
            fault = _unreadable(path)
        else:
            fault = output_fault(path, known.bytes, known.sha256)
        found.files += 1
        if fault is not None:
            text = f"{fault}: it is a result of `{command}`: run this command again"
            found.notices.append(rig.Notice("output-damaged", text, str(path), "error"))
    if without:
        text = (
            f"{rig.pluralize(without, 'file')} without a hash in the records of an earlier "
            "program: only whether they can be read was checked"
        )
        found.notices.append(rig.Notice("output-without-hash", text, severity="info"))


def _unreadable(path: Path) -> str | None:
    """Return why a file without a known hash is not a result; None if it can be one."""
    if not os.path.lexists(path):
        return "is missing"
    try:
        if path.suffix in _IMAGES:
            acquisition.read_image(path)
        elif path.is_file():
            rig.files.read_head(path, 1)
    except (acquisition.DataError, rig.UnreadableError) as error:
        return str(error).removeprefix(f"{path}: ")
    return None


def _check_inputs(inputs: Mapping[tuple[str, str], Path], found: Verification) -> None:
    missing = []
    compacted = set(_compacted(inputs))
    for (name, digest), record in shown("checking the inputs", [*inputs.items()]):
        places = _places(name, record)
        if not places and name not in compacted:
            missing.append(name)
            continue
        found.inputs += 1
        if name not in compacted and not any(_has(path, digest) for path in places):
            text = f"has changed since the result was computed (record: {record})"
            found.notices.append(rig.Notice("input-changed", text, str(places[0]), "error"))
    found.inputs_missing = len(missing)
    if missing:
        text = f"not there, and so not compared: {rig.listed(map(str, missing), 1)}"
        found.notices.append(rig.Notice("input-missing", text, severity="info"))


def _compacted(inputs: Mapping[tuple[str, str], Path]) -> Iterator[str]:
    """Yield the names of inputs that a compaction of their session has replaced."""
    for (name, digest), record in inputs.items():
        if Path(name).name != JOURNAL:
            continue
        folder = Path(name).parent
        for journal in _places(name, record):
            if not _has(journal, digest) and (session := compacted_since(journal, digest)):
                yield from (name, str(folder / "COMPLETE"))
                yield from (str(folder / frame.line.file) for frame in session.recorded)


def _places(name: str, record: Path) -> list[Path]:
    """Return the files that an input can be now.

    A relative path begins at the folder in which the command ran: the current one, or one that
    contains the result.
    """
    starts = [Path(), *record.absolute().parents]
    return [
        path for path in dict.fromkeys(start / name for start in starts) if os.path.isfile(path)
    ]


def _has(path: Path, digest: str) -> bool:
    with suppress(OSError):
        return sha256(path) == digest
    return False
