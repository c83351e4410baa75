"""Output folders: refused while they hold something, and never left without a record."""

from __future__ import annotations

import functools
import hashlib
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ParamSpec

from sgp import __version__
from sgp._exit import UsageError
from sgp._result import Result, dumps, plain

P = ParamSpec("P")


def writes_folder(record: str) -> Callable[[Callable[P, Result]], Callable[P, Result]]:
    """Make a command guard its ``out`` folder and leave a record there.

    Before the work, a folder that holds anything is refused unless ``force``. After it, the file
    ``record`` tells parameters, input hashes, software version, figures and warnings; it comes
    last, so its presence says that the result is whole. With ``out=None`` nothing is written.
    """

    def decorate(command: Callable[P, Result]) -> Callable[P, Result]:
        signature = inspect.signature(command)

        @functools.wraps(command)
        def run(*args: P.args, **kwargs: P.kwargs) -> Result:
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            parameters = dict(bound.arguments)
            out, force = parameters.pop("out"), parameters.pop("force")
            if out is None:
                return command(*args, **kwargs)
            check_folder(out, force=force)
            result = command(*args, **kwargs)
            write_record(out / record, _name(command), parameters, result)
            return result

        return run

    return decorate


def _name(command: Callable[..., Result]) -> str:
    words = ["sgp", command.__module__.rpartition(".")[2], command.__name__.rstrip("_")]
    return " ".join(dict.fromkeys(words))


def check_folder(out: Path, *, force: bool) -> None:
    """Refuse an output folder that holds anything, unless ``force``.

    Raises
    ------
    UsageError
        If the path is a file, or a folder that is not empty and ``force`` is not given.
    """
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out} is a file: give --out a folder")
    if out.is_dir() and any(out.iterdir()) and not force:
        raise UsageError(f"{out} already holds files: choose another --out, or add --force")


def check_file(out: Path, *, force: bool) -> None:
    """Refuse an output file that exists, unless ``force``.

    Raises
    ------
    UsageError
        If the path is a folder, its folder does not exist, or the file does and ``force`` is not
        given.
    """
    if out.is_dir():
        raise UsageError(f"{out} is a folder: give --out a file name")
    if not out.parent.is_dir():
        raise UsageError(f"{out.parent} does not exist: make it, or give another --out")
    if out.exists() and not force:
        raise UsageError(f"{out} exists already: choose another --out, or add --force")


def write_record(path: Path, command: str, parameters: Mapping[str, Any], result: Result) -> None:
    """Write the .json beside a result."""
    record = {
        **provenance(command, parameters, result.inputs),
        "metrics": result.metrics,
        "warnings": result.warnings,
    }
    path.write_text(dumps(record) + "\n", encoding="utf-8")


def provenance(command: str, parameters: Mapping[str, Any], inputs: list[Path]) -> dict[str, Any]:
    """Return what a result was made by and from: command, version, parameters, input hashes."""
    return {
        "command": command,
        "software": {"name": "surface-geometry-processing", "version": __version__},
        "parameters": plain(parameters),
        "inputs": {str(file): _sha256(file) for file in inputs},
    }


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
