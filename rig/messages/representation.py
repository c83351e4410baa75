"""Representations of values that fit in one line, for notebooks."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from rig.messages.notice import listed, pluralize

_LONGEST_TEXT = 60
# Longer collections show only their length.
_MOST_NUMBERS = 4
_MOST_DIFFERENCES = 8


def short_repr(self: object) -> str:
    """Return a dataclass or named tuple as one line; a class assigns it to ``__repr__``.

    Arrays show their type and shape, collections their length, and values that use this function
    themselves only their class. Fields that are None or empty are left out.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> from rig import short_repr
    >>> @dataclass
    ... class Tile:
    ...     pixels: np.ndarray
    ...     __repr__ = short_repr
    >>> Tile(np.zeros((4, 5), np.uint16))
    Tile(pixels=uint16[4, 5])
    """
    if is_dataclass(self):
        names = [field.name for field in fields(self) if field.repr]
    else:
        names = list(getattr(self, "_fields", ()))
    values = {name: getattr(self, name) for name in names if not name.startswith("_")}
    shown = [f"{name}={_shown(value)}" for name, value in values.items() if not _empty(value)]
    return f"{type(self).__name__}({', '.join(shown)})"


def differences(before: Mapping[str, object], after: Mapping[str, object]) -> str:
    """Return the values that are not the same as text; empty if all are."""
    names = [name for name in {**before, **after} if before.get(name) != after.get(name)]
    changes = (f"{name} was {before.get(name)} and is {after.get(name)}" for name in names)
    return listed(changes, _MOST_DIFFERENCES)


def _empty(value: object) -> bool:
    if isinstance(value, np.ndarray):
        return False
    return value is None or (isinstance(value, Collection) and len(value) == 0)


def _shown(value: object) -> str:
    match value:
        case np.ndarray():
            return f"{value.dtype}{list(value.shape)}"
        case float():
            return f"{value:.6g}"
        case Path() | datetime():
            return str(value)
        case str():
            long = len(value) > _LONGEST_TEXT
            return repr(f"{value[:_LONGEST_TEXT]}..." if long else value)
        case tuple() if len(value) <= _MOST_NUMBERS and _are_numbers(value):
            return f"({', '.join(map(_shown, value))})"
        case tuple() | list() | dict() if not hasattr(value, "_fields"):
            return pluralize(len(value), "item")
    return f"{type(value).__name__}(...)" if type(value).__repr__ is short_repr else repr(value)


def _are_numbers(values: tuple[object, ...]) -> bool:
    return all(isinstance(value, int | float) for value in values)
