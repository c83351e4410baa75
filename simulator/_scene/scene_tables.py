"""Convert between the tables of a scene file and the objects that they describe.

The keys of a table are the parameters of the object, so there is no second list of parameters that
could become outdated. A new surface or pattern needs only an entry in a mapping of kinds.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from acquisition import DataError
from rig import validation_message

Kinds = Mapping[str, Callable[..., Any]]

_LARGEST = 1e12
_CONFIG = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def build(maker: Callable[..., Any], values: Mapping[str, Any], where: str, **defaults: Any) -> Any:
    """Call a class or function with the keys of a table, checked against its signature.

    Parameters
    ----------
    maker
        A dataclass or an annotated function.
    values
        Keys and values of the table.
    where
        Name of the table, for messages.
    **defaults
        Values of parameters that are not in the table; ignored if ``maker`` has no parameter of
        that name.

    Raises
    ------
    DataError
        If a key is unknown or missing, a value has the wrong type, or ``maker`` raises it. The
        message names table and key.
    """
    model = _model(maker)
    keys = model.model_fields
    values = {name: value for name, value in defaults.items() if name in keys} | dict(values)
    try:
        read = model.model_validate(values)
    except ValidationError as error:
        message = validation_message(error, noun="key", known=keys)
        raise DataError(f"[{where}]: {message}") from error
    check_range(read, where)
    try:
        return maker(**{name: getattr(read, name) for name in keys})
    except DataError as error:
        raise DataError(f"[{where}]: {error}") from error


def check_range(read: BaseModel, where: str) -> None:
    """Check that no number is so large that its square could overflow.

    Raises
    ------
    DataError
        If a number is too large; the message names table and key.
    """
    for key, value in read:
        numbers = [value]
        while numbers:
            number = numbers.pop()
            if isinstance(number, (tuple, list)):
                numbers += number
            elif isinstance(number, float) and abs(number) > _LARGEST:
                raise DataError(f"[{where}]: key {key!r}: {number:g} is larger than {_LARGEST:g}")


def build_kind(kinds: Kinds, values: Mapping[str, Any], where: str, **defaults: Any) -> Any:
    """Build an object of the kind that the key ``kind`` of a table names.

    Raises
    ------
    DataError
        If the kind is missing or unknown, or `build` raises it.
    """
    rest = dict(values)
    kind = rest.pop("kind", None)
    if not isinstance(kind, str) or kind not in kinds:
        fault = "kind is missing" if kind is None else f"unknown kind {kind!r}"
        raise DataError(f"[{where}]: {fault}: use one of {', '.join(kinds)}")
    return build(kinds[kind], rest, where, **defaults)


def table(value: Any) -> dict[str, Any]:
    """Return a dataclass as a table, without None and without default values.

    Seeds are always included; otherwise a reader would use the seed of its own scene.
    """
    entries: dict[str, Any] = {}
    for item in dataclasses.fields(value):
        content = getattr(value, item.name)
        if content is not None and (item.name == "seed" or not _same(content, item.default)):
            entries[item.name] = content
    return entries


def kind_table(kinds: Kinds, value: Any) -> dict[str, Any]:
    """Return an object as a table with its kind.

    Raises
    ------
    DataError
        If scene files have no kind for the object.
    """
    for kind, maker in kinds.items():
        if type(value) is maker:
            return {"kind": kind} | table(value)
    raise DataError(f"a scene file has no kind for a {type(value).__name__}")


@functools.cache
def _model(maker: Callable[..., Any]) -> type[BaseModel]:
    hints = get_type_hints(maker)
    parts: dict[str, Any] = {}
    for name, parameter in inspect.signature(maker).parameters.items():
        required = parameter.default is inspect.Parameter.empty
        parts[name] = (hints[name], ... if required else parameter.default)
    return create_model(maker.__name__, __config__=_CONFIG, **parts)


def _same(content: Any, default: Any) -> bool:
    return type(content) is type(default) and bool(content == default)
