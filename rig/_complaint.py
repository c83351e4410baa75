"""What pydantic objects to, in one line for people."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import ValidationError
from pydantic_core import ErrorDetails

_LONGEST_VALUE = 40
_MOST = 3


def complaints(error: ValidationError, *, noun: str = "key", known: Iterable[str] = ()) -> str:
    """Return what pydantic objects to, unknown names before others, as one line.

    Parameters
    ----------
    error
        What a model raised.
    noun
        What a field is called where it comes from: a key of a file, an option.
    known
        Names that an unknown one at the top may have been meant for.

    Returns
    -------
    str
        Up to three complaints: which field (``lights.1.id`` where it is nested), what is wrong with
        it, its value where that is short. Then how many more there are.
    """
    errors = error.errors(include_url=False)
    # A list counts as too short by its items that are wrong: those have been told.
    lists = {one["loc"][:-1] for one in errors}
    errors = [one for one in errors if one["type"] != "too_short" or one["loc"] not in lists]
    # A misspelt key is both unknown and missing: the unknown one says which word to mend.
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
