"""Limits of parameters, and whether a part conforms to them (ISO 14253-1)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from acquisition import DataError
from acquisition.files.text_files import read_toml
from processing.roughness.areal_parameters import AREAL, Parameter
from processing.roughness.profile_parameters import PROFILE
from processing.roughness.step_height import STEP
from processing.roughness.uncertainty import Quantity

PARAMETERS: Final[Mapping[str, Parameter]] = {**AREAL, **PROFILE, **STEP}
Conformity = Literal["conforms", "exceeded", "undecided"]


class Limit(BaseModel):
    """Limits of a parameter, a table ``[[limit]]`` of a file.

    Parameters
    ----------
    parameter
        Name of the parameter.
    region
        Name of the area or line; None for all that have the parameter.
    least, most
        Limits in the unit of the parameter; None for none.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    parameter: str
    region: str | None = None
    least: float | None = None
    most: float | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.parameter not in PARAMETERS:
            raise ValueError(
                f"{self.parameter} is not a parameter: use one of {', '.join(PARAMETERS)}"
            )
        if self.least is None and self.most is None:
            raise ValueError(f"{self.parameter} has neither least nor most: give one or both")
        if self.least is not None and self.most is not None and self.least > self.most:
            raise ValueError(f"{self.parameter}: least is above most")
        return self

    def judge(self, quantity: Quantity) -> Conformity:
        """Return whether a quantity conforms: the expanded uncertainty (k = 2) counts.

        A part conforms if the complete interval is within the limits, and exceeds them if the
        complete interval is beyond one of them (ISO 14253-1). Without an uncertainty, and if it is
        not assured, neither is proven.
        """
        value, expanded = quantity.value, 2 * quantity.sigma
        least = -math.inf if self.least is None else self.least
        most = math.inf if self.most is None else self.most
        if not math.isfinite(value + expanded) or quantity.doubts:
            return "undecided"
        if value + expanded < least or value - expanded > most:
            return "exceeded"
        if value - expanded >= least and value + expanded <= most:
            return "conforms"
        return "undecided"

    def __str__(self) -> str:
        unit = PARAMETERS[self.parameter].unit
        ends = [
            f"{word} {value:g}{unit and ' '}{unit}"
            for word, value in (("at least", self.least), ("at most", self.most))
            if value is not None
        ]
        return f"{self.parameter} {' and '.join(ends)}"


class _LimitsFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    limit: list[Limit] = Field(min_length=1)


def read_limits(path: Path) -> list[Limit]:
    r"""Read a TOML file of tables ``[[limit]]`` with parameter, least, most and perhaps region.

    Raises
    ------
    DataError
        If the file cannot be read, a key or parameter is not known, or a limit has no number.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from processing.roughness import read_limits
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder) / "seal.toml"
    ...     _ = file.write_text('[[limit]]\nparameter = "Sa"\nmost = 1.6\n')
    ...     print(*read_limits(file))
    Sa at most 1.6 um
    """
    return read_toml(_LimitsFile, path).limit


def applied(
    limits: Iterable[Limit], measured: Sequence[tuple[str, Mapping[str, Quantity]]]
) -> list[tuple[Limit, str, Quantity, Conformity]]:
    """Return each limit with the name of the region, the quantity and the answer.

    An area and lines may have the same name.

    Raises
    ------
    DataError
        If no region has the parameter of a limit.

    Examples
    --------
    >>> from processing.roughness import Limit, Quantity, applied
    >>> rough = Quantity("Sa", "um", 1.0, 1.0, {"noise": 0.1})
    >>> limit = Limit(parameter="Sa", most=1.6)
    >>> [(_, region, _, answer)] = applied([limit], [("rim", {"Sa": rough})])
    >>> region, answer
    ('rim', 'conforms')
    """
    found = list[tuple[Limit, str, Quantity, Conformity]]()
    for limit in limits:
        judged = [
            (limit, name, values[limit.parameter], limit.judge(values[limit.parameter]))
            for name, values in measured
            if limit.region in (None, name) and limit.parameter in values
        ]
        if not judged:
            where = "any region" if limit.region is None else f"region {limit.region}"
            raise DataError(
                f"{limit.parameter} of {where} has a limit, but was not measured: measured are "
                f"{', '.join(name for name, _ in measured)}; areas have S parameters, profiles R "
                "and W, steps d"
            )
        found += judged
    return found
