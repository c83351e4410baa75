"""What pydantic objects to, in one line for people."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import ValidationError

_LONGEST_VALUE = 40


def first_complaint(error: ValidationError, *, noun: str = "key", known: Iterable[str] = ()) -> str:
    """Return the first thing pydantic objects to, unknown names before others, as one line.

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
        Which field (``lights.1.id`` where it is nested), what is wrong with it, its value where
        that is short, and how many more complaints there are.
    """
    errors = error.errors(include_url=False)
    # A list counts as too short by its items that are wrong: those have been told.
    lists = {one["loc"][:-1] for one in errors}
    errors = [one for one in errors if one["type"] != "too_short" or one["loc"] not in lists]
    # A misspelt key is both unknown and missing: the unknown one says which word to mend.
    first = min(errors, key=lambda one: one["type"] != "extra_forbidden")
    where = f"{noun} {'.'.join(str(part) for part in first['loc'])!r}"
    match first["type"]:
        case "extra_forbidden":
            names = ", ".join(known) if len(first["loc"]) == 1 else ""
            said = f"unknown {where}" + (f"; known are {names}" if names else "")
        case "missing":
            said = f"the {where} is missing"
        case "value_error":
            what = first["msg"].removeprefix("Value error, ")
            said = f"{where}: {what}" if first["loc"] else what
        case _:
            value = first["input"]
            plain = isinstance(value, str | int | float) and len(repr(value)) <= _LONGEST_VALUE
            said = f"{where}: {first['msg']}" + (f", not {value!r}" if plain else "")
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    return " ".join(said.split()) + more
