"""Tables of a scene file and the objects they describe: keys are the objects' own parameters.

A surface or pattern added to the simulator is in the format as soon as it has a name here; there is
no second list of its parameters that could fall behind.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from acquisition import DataError
from rig import complaints

Kinds = Mapping[str, Callable[..., Any]]

_LARGEST = 1e12
_CONFIG = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def build(maker: Callable[..., Any], values: Mapping[str, Any], where: str, **given: Any) -> Any:
    """Call a class or function with the keys of a table, checked by its own signature.

    Parameters
    ----------
    maker
        A dataclass or an annotated function.
    values
        The table.
    where
        Name of the table, for messages.
    **given
        Values for those parameters of these names that the table leaves open.

    Raises
    ------
    DataError
        If a key is unknown or missing, a value is of another type, or the maker refuses it. The
        message names table and key.
    """
    model = _model(maker)
    keys = model.model_fields
    values = {name: value for name, value in given.items() if name in keys} | dict(values)
    try:
        read = model.model_validate(values)
    except ValidationError as error:
        complaint = complaints(error, noun="key", known=keys)
        raise DataError(f"[{where}]: {complaint}") from error
    check_range(read, where)
    try:
        return maker(**{name: getattr(read, name) for name in keys})
    except DataError as error:
        raise DataError(f"[{where}]: {error}") from error


def check_range(read: BaseModel, where: str) -> None:
    """Refuse numbers so large that their squares would overflow.

    Raises
    ------
    DataError
        If there is one; the message names table and key.
    """
    for key, value in read:
        numbers = [value]
        while numbers:
            number = numbers.pop()
            if isinstance(number, (tuple, list)):
                numbers += number
            elif isinstance(number, float) and abs(number) > _LARGEST:
                raise DataError(f"[{where}]: key {key!r}: {number:g} is beyond {_LARGEST:g}")


def build_kind(kinds: Kinds, values: Mapping[str, Any], where: str, **given: Any) -> Any:
    """Build what the key ``kind`` of a table names.

    Errors are those of `build`, and an unknown kind.
    """
    rest = dict(values)
    kind = rest.pop("kind", None)
    if not isinstance(kind, str) or kind not in kinds:
        said = "has no kind" if kind is None else f"kind {kind!r} is not known"
        raise DataError(f"[{where}]: {said}: take one of {', '.join(kinds)}")
    return build(kinds[kind], rest, where, **given)


def table(value: Any) -> dict[str, Any]:
    """Lay a dataclass out as a table, without what has its default value or is None.

    Seeds are always told: left open, they would be those of another reader.
    """
    made: dict[str, Any] = {}
    for item in dataclasses.fields(value):
        content = getattr(value, item.name)
        if content is not None and (item.name == "seed" or not _same(content, item.default)):
            made[item.name] = content
    return made


def kind_table(kinds: Kinds, value: Any) -> dict[str, Any]:
    """Lay an object out as a table with its kind.

    Raises
    ------
    DataError
        If it is of no kind that a file knows.
    """
    for kind, maker in kinds.items():
        if type(value) is maker:
            return {"kind": kind} | table(value)
    raise DataError(f"a {type(value).__name__} has no place in a scene file")


@functools.cache
def _model(maker: Callable[..., Any]) -> type[BaseModel]:
    hints = get_type_hints(maker)
    parts: dict[str, Any] = {}
    for name, parameter in inspect.signature(maker).parameters.items():
        open_ = parameter.default is inspect.Parameter.empty
        parts[name] = (hints[name], ... if open_ else parameter.default)
    return create_model(maker.__name__, __config__=_CONFIG, **parts)


def _same(content: Any, default: Any) -> bool:
    return type(content) is type(default) and bool(content == default)
