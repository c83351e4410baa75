"""The record that a command leaves in its output folder."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, create_model

import acquisition
import processing
import rig
from sgp.results.metrics import COMMANDS, RECORD_FORMAT, RECORD_VERSION
from sgp.results.verdict import recorded_verdict

_Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class _OpenTable(_Table):
    model_config = ConfigDict(extra="ignore")


class Software(_Table):
    """The program that computed a result."""

    name: str
    version: str


class OutputFile(_Table):
    """Size and hash of a file of a result."""

    bytes: int
    sha256: _Sha256


class CauseTable(_OpenTable):
    """A `processing.checks.Cause`, with None where a figure is not known."""

    name: str
    text: str
    size: float | None
    unit: str
    sigma: float | None
    normals_deg: float | None
    height_mm: float | None
    remedy: str
    inverts: bool
    alternatives: tuple[str, ...]
    where: str
    share: float | None = None


class TestedTable(_OpenTable):
    """The figures of a `processing.checks.Verdict`, with None where one is not known."""

    sigma_deg: float | None
    residual: float | None
    noise: float | None
    unexplained_deg: float | None
    tried: tuple[str, ...]
    not_excluded: tuple[str, ...]
    least: dict[str, str]


class ResultRecord(_Table):
    """What a command computed, from which inputs, with which parameters.

    Parameters
    ----------
    format
        ``sgp-result``; a reader refuses other values.
    version
        1; a reader refuses other values.
    command
        The command that ran, such as ``sgp normals``.
    software
        Name and version of the program that ran it.
    parameters
        The arguments of the command by name, defaults included, and what it chose itself:
        ``transfer``, the transfer curve of the images; ``albedo_png``, with ``white``, the albedo
        of a sample of 255 (other samples follow the sRGB curve); ``height_png``, with ``base``,
        ``step`` and ``unit``: the height is ``base + step * sample``, and a sample of 0 has none.
    defaults
        Names of the parameters that have their default values; absent if every one was given.
    inputs
        SHA-256 of every file that was read, by its path.
    recordings
        What the recordings were of that the result was computed from, without those of its
        calibrations: ``object``, ``operator``, ``place``, ``notes``, ``rights``, ``started_utc``
        (texts, empty if not known) and ``simulated``. They come from ``session.toml`` or
        ``recording.json``, or from the record of the result that an input belongs to. Absent
        without a recording, and in records of earlier programs.
    outputs
        File names of the results, relative to the record.
    metrics
        Figures by name; None where a figure is not defined. The types of `sgp.results.metrics`
        describe those of each command.
    warnings
        What the command reported, one line each: ``where: text``, or ``text`` if ``where`` is
        empty.
    notices
        The same with ``code``, ``text``, ``where`` (file, frame, LED or sphere) and ``severity``
        (``info``, ``warning``, ``error``).
    files
        ``bytes`` and ``sha256`` of each output by its file name, except pages (``.html``), which
        `sgp report` writes again; in ``summary.json`` also of the records of the stages. Missing
        in records of earlier programs.
    verdict
        ``good``, ``check`` or ``do-not-use``, from a command that judges its result.
    causes
        What is probably wrong with the recording, the most harmful first, also what does not harm.
    tested
        What was tested.
    record_sha256
        SHA-256 of all other keys, written as JSON in ASCII with sorted keys and the separators
        ``, `` and ``: ``; `sgp verify` compares it.
    """

    format: Literal["sgp-result"] = RECORD_FORMAT
    version: Literal[1] = RECORD_VERSION
    command: str
    software: Software
    parameters: dict[str, JsonValue]
    defaults: tuple[str, ...] = ()
    inputs: dict[str, _Sha256]
    recordings: tuple[acquisition.Identity, ...] = ()
    outputs: dict[str, str]
    metrics: dict[str, JsonValue]
    warnings: tuple[str, ...]
    notices: tuple[rig.Notice, ...]
    verdict: processing.checks.Answer | None = None
    causes: tuple[CauseTable, ...] = ()
    tested: TestedTable | None = None
    files: dict[str, OutputFile] = Field(default_factory=dict)
    record_sha256: _Sha256 | None = None

    @property
    def judged(self) -> processing.checks.Verdict | None:
        """The verdict with its causes; None if the command has none."""
        if self.verdict is None or self.tested is None:
            return None
        return recorded_verdict(self.model_dump(include={"causes", "tested"}))

    def __repr__(self) -> str:
        counts = (
            f"{len(self.inputs)} inputs, {len(self.outputs)} outputs, {len(self.notices)} notices"
        )
        return f"ResultRecord({self.command}, {counts})"


def read_record(path: str | Path) -> ResultRecord:
    """Read the record of a result.

    Parameters
    ----------
    path
        The ``.json`` that a command left in its output folder.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If the file is not a record, is of another version, has an unknown key, or a key or a
        figure is missing or invalid; the message names the file. Figures that this program does
        not know, and those of a command that it does not know, are kept without a check.
    """
    path = Path(path)
    try:
        values = rig.files.parse_json(rig.read_bounded(path))
    except FileNotFoundError as error:
        raise acquisition.MissingPathError(f"{path}: no such file") from error
    except rig.UnreadableError as error:
        raise acquisition.DataError(
            f"{path}: is the record of a result and is cut short or damaged ({error}): run the "
            "command that wrote it again"
            if RECORD_FORMAT.encode() in _head(path)
            else f"{path}: {error}"
        ) from error
    if not isinstance(values, dict) or values.get("format") != RECORD_FORMAT:
        raise acquisition.DataError(
            f"{path}: is not the record of a result: its format is not {RECORD_FORMAT!r}"
        )
    if values.get("version") != RECORD_VERSION:
        raise acquisition.DataError(
            f"{path}: has version {str(values.get('version'))[:20]} of {RECORD_FORMAT}, and this "
            f"program reads version {RECORD_VERSION}: run the command again, or update the program"
        )
    try:
        # Lists become tuples in JSON mode only.
        record = ResultRecord.model_validate(values, strict=False)
        check_metrics(record.command, record.metrics)
    except ValidationError as error:
        raise acquisition.DataError(f"{path}: {rig.messages.validation_message(error)}") from error
    return record


def is_record(path: Path) -> bool:
    """Return whether a file is the record of a result, even if it is cut short."""
    try:
        content = rig.files.parse_json(rig.read_bounded(path))
    except FileNotFoundError:
        return False
    except rig.UnreadableError:
        return RECORD_FORMAT.encode() in _head(path)
    return isinstance(content, dict) and content.get("format") == RECORD_FORMAT


def _head(path: Path) -> bytes:
    try:
        return rig.files.read_head(path, 200)[0]
    except (FileNotFoundError, rig.UnreadableError):
        return b""


def records_of(path: Path) -> Iterator[tuple[Path, ResultRecord]]:
    """Yield the records next to a file that name it as their output; other files are ignored."""
    for file in sorted(path.parent.glob("*.json")):
        try:
            record = read_record(file)
        except (acquisition.DataError, acquisition.MissingPathError):
            continue
        if path.name in (Path(output).name for output in record.outputs.values()):
            yield file, record


def check_metrics(
    command: str, metrics: Mapping[str, JsonValue], *, declared_only: bool = False
) -> None:
    """Check the figures of a command against its declared ones; other commands may have any.

    Later programs of the same version may add optional figures, so that unknown ones are accepted
    unless ``declared_only``.

    Raises
    ------
    ValidationError
        If a figure is missing or invalid, or unknown with ``declared_only``.
    """
    if command not in COMMANDS:
        return
    # Of the records of `sgp run`, this is the one with the most figures in common.
    declared = max(COMMANDS[command], key=lambda kind: len(metrics.keys() & kind.__annotations__))
    base = _Table if declared_only else _OpenTable
    model = create_model("Figures", __base__=base, metrics=(declared, ...))
    # Names of files may contain bytes that are not UTF-8.
    text = json.dumps({"metrics": metrics}, ensure_ascii=False).encode(errors="replace")
    model.model_validate_json(text)
