"""Validation errors of pydantic as one readable line."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import ValidationError
from pydantic_core import ErrorDetails

_LONGEST_VALUE = 40
_MOST = 3


def validation_message(
    error: ValidationError, *, noun: str = "key", known: Iterable[str] = ()
) -> str:
    """Return the errors that pydantic found as one line, unknown names first.

    Parameters
    ----------
    error
        Exception raised by a model.
    noun
        What users call a field: a key of a file, an option.
    known
        Valid names at the top level, listed if an unknown one is found there.

    Returns
    -------
    str
        Up to three complaints, each with the field (``lights.1.id`` if nested), what is wrong with
        it, and its value if that is short; then the number of further complaints.

    Examples
    --------
    >>> from pydantic import BaseModel, ValidationError
    >>> from rig.messages import validation_message
    >>> class Lamp(BaseModel):
    ...     watts: float
    >>> try:
    ...     Lamp(watts="many")
    ... except ValidationError as error:
    ...     print(validation_message(error))
    key 'watts': Input should be a valid number, unable to parse string as a number, not 'many'
    """
    errors = error.errors(include_url=False)
    # A list with invalid items is also reported as too short: the items are enough.
    lists = {one["loc"][:-1] for one in errors}
    errors = [one for one in errors if one["type"] != "too_short" or one["loc"] not in lists]
    # A misspelt key is both unknown and missing: the unknown one shows which word to correct.
    errors.sort(key=lambda one: one["type"] != "extra_forbidden")
    said = [_said(one, noun) for one in errors[:_MOST]]
    if errors[0]["type"] == "extra_forbidden" and len(errors[0]["loc"]) == 1 and known:
        said[0] += f"; known are {', '.join(known)}"
    more = f" (and {len(errors) - _MOST} more)" if len(errors) > _MOST else ""
    return " ".join("; ".join(said).split()) + more


def _said(one: ErrorDetails, noun: str) -> str:
    where = f"{noun} {'.'.join(str(part) for part in one['loc'])!r}"
    match one["type"]:
        case "extra_forbidden":
            return f"unknown {where}"
        case "missing":
            return f"the {where} is missing"
        case "value_error":
            what = one["msg"].removeprefix("Value error, ")
            return f"{where}: {what}" if one["loc"] else what
        case _:
            value = one["input"]
            plain = isinstance(value, str | int | float) and len(repr(value)) <= _LONGEST_VALUE
            return f"{where}: {one['msg']}" + (f", not {value!r}" if plain else "")
