"""Options that several commands share, and their bounds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from processing import Method
from sgp._exit import UsageError

Seed = Annotated[int, Parameter(validator=Number(gte=0, lt=2**63))]
Count = Annotated[int, Parameter(validator=Number(gte=1))]
Positive = Annotated[float, Parameter(validator=Number(gt=0, lt=float("inf")))]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """How a recording becomes normals.

    Parameters
    ----------
    lights
        lights.json, .lp or DiLiGenT text; default: those of the source.
    camera
        Needed for lights with positions: our JSON, OpenCV YAML, COLMAP or a 3x3 matrix.
    mask
        Image of the object; default: the source's own, else made from the images.
    method
        ls (plain least squares) or cauchy (shadows and highlights lose their weight).
    distant
        Take lights with positions as directions.
    gamma
        Exponent that makes the images linear (2.2 for display-ready ones); default: linear already.
    """

    lights: Path | None = None
    camera: Path | None = None
    mask: Path | None = None
    method: Method = "cauchy"
    distant: bool = False
    gamma: Positive | None = None


def numbers(option: str, text: str, count: int) -> list[float]:
    """Read ``x,y,...``.

    Raises
    ------
    UsageError
        If there are not ``count`` numbers.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise UsageError(f"{option} {text}: give {count} numbers with commas between")
    return values
