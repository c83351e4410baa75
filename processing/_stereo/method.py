"""The names of the estimators."""

from __future__ import annotations

from typing import Literal, get_args

Method = Literal["ls", "trimmed", "cauchy", "best"]
METHODS: tuple[Method, ...] = get_args(Method)
