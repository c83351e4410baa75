"""JSON texts as validated models, with errors in one line."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from acquisition._errors import DataError, convert_read_errors
from rig import check_text, validation_message

Model = TypeVar("Model", bound=BaseModel)


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
