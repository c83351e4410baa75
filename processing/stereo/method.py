"""The names of the estimators, and of the channels that are solved."""

from __future__ import annotations

from typing import Literal, get_args

Method = Literal["ls", "trimmed", "cauchy", "best"]
StereoChannel = Literal["gray", "rgb", "joint", "mosaic"]
METHODS: tuple[Method, ...] = get_args(Method)
