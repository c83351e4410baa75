"""TOML files as validated models, with errors in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import tomli_w
from pydantic import BaseModel, ValidationError

import rig
from acquisition._errors import DataError, convert_read_errors
from rig import MAX_TOML_BYTES, read_bounded, validation_message

Model = TypeVar("Model", bound=BaseModel)


def parse_toml(data: bytes, path: Path) -> dict[str, Any]:
    """Parse TOML bytes; a DataError names ``path`` and the invalid line."""
    with convert_read_errors(path):
        return rig.parse_toml(data)


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
