"""Text files, also of other programs, and the models of JSON and TOML files, checked in one line.

Byte order marks, line ends and old encodings are read as they come.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, get_args

import tomli_w
from pydantic import BaseModel, ConfigDict, ValidationError, create_model

import rig
from acquisition._errors import DataError, convert_read_errors
from rig import read_bounded
from rig.files import MAX_TOML_BYTES, check_text
from rig.messages import validation_message

Model = TypeVar("Model", bound=BaseModel)


def read_text(path: Path) -> str:
    """Read a text file: UTF-8 with or without a byte order mark, otherwise Latin-1.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If it cannot be read, is not text, or is larger than 16 MB.
    """
    with convert_read_errors(path):
        data = read_bounded(path)
    if b"\0" in data:
        raise DataError(f"{path}: not a text file: save it as text in UTF-8")
    return text_of(data)


def text_of(data: bytes) -> str:
    """Decode UTF-8 with or without a byte order mark, otherwise Latin-1."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")  # names written by old Windows programs


def numbered_lines(text: str) -> list[tuple[int, str]]:
    """Return (line number from 1, stripped text) of the lines that are not blank."""
    stripped = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    return [(number, line) for number, line in stripped if line]


def parse_json(model: type[Model], text: str, path: Path, hint: str = "") -> Model:
    """Build a model from a JSON text.

    Raises
    ------
    DataError
        If the text is not JSON, or contains a key or value that the model refuses; the message
        names ``path`` and the key, and ends with ``hint``.
    """
    with convert_read_errors(path):
        check_text(text)
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        raise DataError(f"{path}: {validation_message(error)}{hint}") from error


def parse_versioned(
    model: type[Model], text: str, path: Path, shown: Callable[[object], str] = repr
) -> Model:
    """Build a model with the fields ``format`` and ``version`` from a JSON text.

    Raises
    ------
    DataError
        As `parse_json`, or if the file has another version, which the message has as ``shown``.
    """
    form: Any = model.model_fields["format"].annotation
    versions = get_args(model.model_fields["version"].annotation)
    config = ConfigDict(extra="ignore", allow_inf_nan=False)
    head = create_model("Head", __config__=config, format=(form, ...), version=(Any, ...))
    stated = parse_json(head, text, path).model_dump()
    if type(stated["version"]) is not int or stated["version"] not in versions:
        raise DataError(
            f"{path}: version {shown(stated['version'])} of {stated['format']} is unknown, this "
            f"program reads {' and '.join(map(str, versions))}: use the program that "
            "wrote the file"
        )
    return parse_json(model, text, path)


def parse_toml(data: bytes, path: Path) -> dict[str, Any]:
    """Parse TOML bytes; a DataError names ``path`` and the invalid line."""
    with convert_read_errors(path):
        return rig.files.parse_toml(data)


def validated(model: type[Model], values: dict[str, Any], path: Path) -> Model:
    """Build a model from parsed values; a DataError names ``path`` and the key."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        message = validation_message(error, known=model.model_fields)
        raise DataError(f"{path}: {message}") from error


def read_toml(model: type[Model], path: Path) -> Model:
    """Read a model from a TOML file.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If it cannot be read, is not TOML, or contains a key or value that the model refuses.
    """
    with convert_read_errors(path):
        data = read_bounded(path, MAX_TOML_BYTES)
    return validated(model, parse_toml(data, path), path)


def to_toml(model: BaseModel) -> bytes:
    """Return a model as TOML without its None fields, because TOML has no null.

    Raises
    ------
    DataError
        If a text cannot be encoded in UTF-8, for instance a command-line argument in another
        encoding.
    """
    text = tomli_w.dumps(model.model_dump(exclude_none=True))
    try:
        return text.encode("utf-8")
    except UnicodeEncodeError as error:
        around = text[: error.start].rpartition("\n")[2] + ascii(error.object[error.start])
        raise DataError(f"{around}: the text is not UTF-8: enter it again") from error
