"""The names of the estimators, and of the channels that are solved."""

from __future__ import annotations

from typing import Literal, get_args

from acquisition import DataError

Method = Literal["ls", "trimmed", "cauchy", "best"]
StereoChannel = Literal["auto", "gray", "rgb", "joint", "mosaic"]
METHODS: tuple[Method, ...] = get_args(Method)


def check_method(name: str) -> None:
    """Refuse a name that is no method, by `DataError`."""
    if name not in METHODS:
        raise DataError(f"{name!r} is not a method of photometric stereo: use {', '.join(METHODS)}")
