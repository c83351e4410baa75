"""Output folders: refuse those that are not empty, and write a record into each."""

from __future__ import annotations

import functools
import inspect
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, ParamSpec

import acquisition
from sgp.cli.console import shown
from sgp.cli.exit import UsageError
from sgp.cli.options import paths_of
from sgp.results.hashes import SEAL, input_hashes, output_files, seal, sha256
from sgp.results.metrics import RECORD_FORMAT, RECORD_VERSION
from sgp.results.recordings import CALIBRATIONS, recordings_of
from sgp.results.result import Result, dumps, json_table, plain
from sgp.results.verdict import verdict_record

try:
    import fcntl
except ImportError:  # Windows: two commands in one folder are not detected
    fcntl = None  # type: ignore[assignment]

P = ParamSpec("P")
# Through which a command locks its folders until it ends, and whether these may contain a result.
_claims: ContextVar[tuple[ExitStack, bool, set[Path]] | None] = ContextVar("claims", default=None)


def writes_folder(record: str) -> Callable[[Callable[P, Result]], Callable[P, Result]]:
    """Make a command check its ``out`` folder before the work and write a record there afterwards.

    A folder that is not empty is refused unless ``force`` is given; a folder that belongs to an
    input is always refused. The file ``record`` contains parameters, input hashes, software
    version, figures and warnings. It is written last, so its presence means that the result is
    complete. With ``out=None`` nothing is written.
    """

    def decorate(command: Callable[P, Result]) -> Callable[P, Result]:
        signature = inspect.signature(command)
        known = {name: one.default for name, one in signature.parameters.items()}
        defaults = flat_parameters(known)

        @functools.wraps(command)
        def run(*args: P.args, **kwargs: P.kwargs) -> Result:
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            parameters = flat_parameters(bound.arguments)
            out, force = parameters.pop("out"), parameters.pop("force")
            if out is None:
                return command(*args, **kwargs)
            force = force or _cut_short(out / record)
            check_output(out, parameters.values(), force=force)
            with ExitStack() as stack:
                stack.callback(_claims.reset, _claims.set((stack, force, set())))
                result = command(*args, **kwargs)
                made = parameters | result.parameters
                write_record(out / record, _name(command), made, result, defaults=defaults)
                return result

        return run

    return decorate


def _cut_short(record: Path) -> bool:
    """Return whether the files next to a missing record are those of a killed process.

    It removes its unfinished maps after the files are complete, before the record; whether they
    belong to the same computation is checked where they are continued.
    """
    return not record.exists() and acquisition.files.is_unfinished(record.with_suffix(""))


def check_output(out: Path, arguments: Iterable[Any], *, force: bool) -> None:
    """Refuse an output folder that is not empty, unless ``force``, or that belongs to an input.

    Raises
    ------
    UsageError
        As `check_folder`, or if the folder is that of a path among the arguments.
    """
    check_folder(out, force=force)
    _check_apart(out, paths_of(arguments))


def claim_folder(out: Path, record: str, inputs: Iterable[Path] = ()) -> Path:
    """Prepare an output folder for writing: create it, or remove the files of an earlier result.

    Commands call this after the computation and before writing, so that a run that fails leaves an
    earlier result as it was, also if one of its ``inputs`` was changed.

    Raises
    ------
    DataError
        If an input was changed after the command had opened it.
    StorageError
        If the folder cannot be created or a file cannot be removed.
    UsageError
        If another command writes into the folder, or has done so since this one began.
    """
    acquisition.files.check_publishing()
    input_hashes(inputs)
    acquisition.make_folder(out)
    claims = _claims.get()
    if claims is not None and out not in claims[2]:
        stack, force, claimed = claims
        other = f"{out}: another command writes its result there: give another --out"
        stack.enter_context(locked(out, other))
        if not force and (out / record).exists():  # not there when the command began
            raise UsageError(other)
        claimed.add(out)
    acquisition.files.remove_part_files(out)
    for path in earlier_files(out, record):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise acquisition.files.storage_error(path, "replace", error) from error
    return out


def earlier_files(out: Path, record: str) -> list[Path]:
    """Return the files of an earlier result with this record in a folder, the record first."""
    paths = [out / name for name in (record, *_earlier_outputs(out / record))]
    return [path for path in paths if os.path.lexists(path)]


def _earlier_outputs(record: Path) -> list[str]:
    """Return the files that a record names in its own folder; none if it cannot be read."""
    outputs = json_table(record).get("outputs")
    names = outputs.values() if isinstance(outputs, dict) else ()
    return [
        name
        for name in names
        if isinstance(name, str) and "\0" not in name and Path(name).name == name
    ]


def flat_parameters(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return a command's arguments by name, with option groups expanded."""
    flat: dict[str, Any] = {}
    for name, value in arguments.items():
        if is_dataclass(value) and not isinstance(value, type):
            flat |= {one.name: getattr(value, one.name) for one in fields(value)}
        else:
            flat[name] = value
    return flat


def _name(command: Callable[..., Result]) -> str:
    # Commands of one group may be in several modules: capture.py, capture_files.py.
    group = command.__module__.rpartition(".")[2].partition("_")[0]
    words = ["sgp", group, command.__name__.rstrip("_")]
    return " ".join(dict.fromkeys(words))


def _check_apart(out: Path, inputs: list[Path]) -> None:
    """Refuse an output folder that is an input folder or is inside a session."""
    target = out.resolve()
    for path in inputs:
        folder = path.resolve() if path.is_dir() else path.resolve().parent
        inside = folder in target.parents if path.is_dir() else False
        if path.exists() and (target == folder or inside) and not _is_derived(target):
            raise UsageError(f"{out} is in the folder of the input {path}: give another --out")


def _is_derived(target: Path) -> bool:
    return any(
        folder.name == "derived" and (folder.parent / "session.toml").is_file()
        for folder in (target, *target.parents)
    )


@contextmanager
def locked(folder: Path, error: str) -> Iterator[None]:
    """Lock a folder as long as this is open, where the file system supports locks.

    Raises
    ------
    UsageError
        With the text ``error``, if another process has locked it.
    """
    if fcntl is None:
        yield
        return
    place = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with suppress(OSError):
            try:
                fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise UsageError(error) from None
        yield
    finally:
        os.close(place)


def check_folder(out: Path, *, force: bool | None = None) -> None:
    """Refuse an output folder that is not empty, unless ``force``.

    ``force=None`` means that the command has no such option.

    Raises
    ------
    UsageError
        If the path is a file, is below a file or in a session, has a name that is not UTF-8, or is
        a folder that is not empty and ``force`` is not given. Part files of interrupted writes do
        not count.
    """
    _check_name(out)
    _check_place(out, out)
    if (
        out.is_dir()
        and not force
        and any(not acquisition.files.is_part_file(path) for path in out.iterdir())
    ):
        instead = "" if force is None else ", or add --force"
        raise UsageError(f"{out} already contains files: choose another folder{instead}")
    target = out.resolve()
    for folder in (target, *target.parents):
        if (folder / "session.toml").is_file() and not _is_derived(target):
            raise UsageError(f"{out} is inside the session {folder}: choose another folder")


def check_file(out: Path, suffix: str, *, force: bool) -> None:
    """Refuse an output file that exists, unless ``force``, or that has another suffix.

    Its folder is created if it does not exist.

    Raises
    ------
    UsageError
        If the path is a folder, has another suffix, is below a file, or the file exists and
        ``force`` is not given.
    StorageError
        If its folder cannot be created.
    """
    _check_name(out)
    if out.is_dir():
        raise UsageError(f"{out} is a folder: give --out a file name")
    if out.suffix.lower() != suffix:
        raise UsageError(f"{out}: --out must end in {suffix}")
    if out.exists() and not force:
        raise UsageError(f"{out} already exists: choose another --out, or add --force")
    _check_place(out.parent, out)
    acquisition.make_folder(out.parent)


def _check_place(folder: Path, out: Path) -> None:
    """Refuse a folder that is a file or below a file."""
    parents = (folder, *folder.absolute().parents)
    place = next((path for path in parents if os.path.lexists(path)), folder)
    if os.path.lexists(place) and not place.is_dir():
        below = "" if place == out else f", so {out} cannot be below it"
        instead = "a folder" if folder == out else "another place"
        raise UsageError(f"{place} is a file{below}: choose {instead}")


def _check_name(out: Path) -> None:
    try:
        str(out).encode()
    except UnicodeEncodeError:
        raise UsageError(f"{out}: the name is not UTF-8: choose another name") from None


def write_record(
    path: Path,
    command: str,
    parameters: Mapping[str, Any],
    result: Result,
    *,
    defaults: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Write the JSON record of a result atomically: a reader never sees a part of it.

    ``defaults`` are the values of parameters that were not given.
    """
    unchanged = [one for one in parameters if one in defaults and defaults[one] == parameters[one]]
    calibrations = paths_of(parameters.get(name) for name in CALIBRATIONS)
    recordings = recordings_of(result.inputs, calibrations)
    outputs = result.outputs.values()
    stages = [one.with_name(f"{one.parent.name}.json") for one in outputs]
    own = [one for one in (*outputs, *stages) if path.parent in one.parents and one != path]
    # A plain mapping with the keys of `ResultRecord`, which readers check: importing pydantic would
    # cost every command a quarter of a second.
    record = {
        "format": RECORD_FORMAT,
        "version": RECORD_VERSION,
        **provenance(command, parameters, result.inputs),
        **({"defaults": unchanged} if unchanged else {}),
        **({"recordings": [asdict(one) for one in recordings]} if recordings else {}),
        "outputs": {
            name: str(output.relative_to(path.parent))
            for name, output in result.outputs.items()
            if output.is_relative_to(path.parent)
        },
        "metrics": result.metrics,
        "warnings": [str(notice) for notice in result.warnings],
        "notices": [asdict(notice) for notice in result.warnings],
        **({} if result.verdict is None else verdict_record(result.verdict)),
        "files": {
            str(file.relative_to(path.parent)): {
                "bytes": file.stat().st_size,
                "sha256": sha256(file),
            }
            for file in shown("hashing the result", output_files(own))
        },
    }
    record[SEAL] = seal(json.loads(dumps(record)))
    acquisition.write_durably(path, f"{dumps(record)}\n".encode())


def stated(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return what provenance states of a command's arguments, which are its first `locals`."""
    unstated = ("out", "max_pixels", "force")
    found = {name: value for name, value in arguments.items() if name not in unstated}
    source = found.get("source")
    return found | ({"source": source[0]} if source and len(source) == 1 else {})


def complete_provenance(
    command: str, parameters: Mapping[str, Any], result: Result
) -> dict[str, Any]:
    """Return the provenance of a file that is passed on without its record, with its figures."""
    noticed = {"metrics": plain(result.metrics), "warnings": [*map(str, result.warnings)]}
    return provenance(command, parameters, result.inputs) | noticed


def provenance(command: str, parameters: Mapping[str, Any], inputs: list[Path]) -> dict[str, Any]:
    """Return the provenance of a result: command, version, parameters, input hashes.

    Raises
    ------
    DataError
        If an input was changed after the command had opened it.
    """
    return {
        "command": command,
        "software": {
            "name": acquisition.files.SOFTWARE,
            "version": acquisition.files.software_version(),
        },
        "parameters": plain(parameters),
        "inputs": input_hashes(inputs),
    }
