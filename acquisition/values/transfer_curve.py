"""The relation between the samples of an image and the light that they stand for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from rig.arrays import Float64

CurveKind = Literal["linear", "srgb", "power", "table"]

# IEC 61966-2-1, 5.2 and 5.3.
_SLOPE, _OFFSET, _EXPONENT = 12.92, 0.055, 2.4
_LAST_SAMPLE, _LAST_LIGHT = 0.04045, 0.0031308
_EXPONENTS = (0.1, 10.0)
# A session.toml holds the points, and must not become too large to be read.
MOST_POINTS = 4096


@dataclass(frozen=True)
class TransferCurve:
    """The transfer curve of an image: samples relative to white, and light relative to white.

    Both are 0 at the black level and 1 at the white level. Use `LINEAR`, `SRGB`,
    `TransferCurve.power` and `TransferCurve.table` instead of the constructor.

    Parameters
    ----------
    kind
        ``linear``; ``srgb`` (IEC 61966-2-1); ``power``: light is the sample to the power of
        ``exponent``; ``table``: light is interpolated linearly between ``points``.
    exponent
        Exponent of a power, 0.1 to 10; None for other kinds.
    points
        Pairs of sample and light, from (0, 0) to (1, 1), both increasing strictly; empty for other
        kinds.

    Raises
    ------
    DataError
        If a value is missing, is outside its range, or belongs to another kind.
    """

    kind: CurveKind = "linear"
    exponent: float | None = None
    points: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in ("linear", "srgb", "power", "table"):
            raise DataError(f"a transfer curve is linear, srgb, power or table, not {self.kind}")
        if (self.exponent is not None) != (self.kind == "power"):
            raise DataError(f"a transfer curve of kind {self.kind}: only a power has an exponent")
        if self.exponent is not None and not _EXPONENTS[0] <= self.exponent <= _EXPONENTS[1]:
            raise DataError(
                f"the exponent of a transfer curve is {self.exponent:g}: give "
                f"{_EXPONENTS[0]:g} to {_EXPONENTS[1]:g}"
            )
        if bool(self.points) != (self.kind == "table"):
            raise DataError(f"a transfer curve of kind {self.kind}: only a table has points")
        if self.points:
            self._check_points()

    @classmethod
    def power(cls, exponent: float) -> TransferCurve:
        """Return the curve ``light = sample ** exponent``; a power of 1 is linear."""
        return LINEAR if exponent == 1 else cls("power", float(exponent))

    @classmethod
    def table(cls, points: npt.ArrayLike) -> TransferCurve:
        """Return a curve through measured points.

        Parameters
        ----------
        points
            ``(N, 2)`` samples and light, N from 2 to 4096, each in any unit. Both columns begin
            with 0 and increase strictly; their last values belong to the white level.

        Raises
        ------
        DataError
            If the array has another form.
        """
        try:
            pairs = np.asarray(points, np.float64)
        except (TypeError, ValueError) as error:
            raise DataError("a table of a transfer curve needs pairs of numbers") from error
        if pairs.ndim != 2 or pairs.shape[1] != 2 or not 2 <= len(pairs) <= MOST_POINTS:
            raise DataError(
                f"a table of a transfer curve needs 2 to {MOST_POINTS} pairs of sample and light"
            )
        if not np.isfinite(pairs).all() or not (pairs[-1] > 0).all():
            raise DataError("a table of a transfer curve needs finite numbers that end above 0")
        scaled = pairs / pairs[-1]
        return cls("table", points=tuple((float(x), float(y)) for x, y in scaled))

    @property
    def name(self) -> str:
        """Name in messages: ``sRGB``, ``linear``, ``gamma 2.2`` or ``a table of 256 points``."""
        match self.kind:
            case "srgb":
                return "sRGB"
            case "power":
                return f"gamma {self.exponent:.6g}"
            case "table":
                return f"a table of {len(self.points)} points"
        return "linear"

    def light(self, samples: npt.ArrayLike) -> Float64:
        """Return the light of samples relative to white, of the same shape.

        A linear curve returns the samples. The others map samples below 0 to 0. Above 1, sRGB and
        powers continue by their formulas, and a table along its last segment.
        """
        values = np.asarray(samples, np.float64)
        if self.kind == "linear":
            return values
        values = np.maximum(values, 0.0)
        match self.kind:
            case "srgb":
                bent = ((values + _OFFSET) / (1 + _OFFSET)) ** _EXPONENT
                return np.asarray(np.where(values <= _LAST_SAMPLE, values / _SLOPE, bent))
            case "power":
                return np.asarray(values**self._power)
        return _interpolated(values, *self._columns)

    def samples(self, light: npt.ArrayLike) -> Float64:
        """Return the samples of light relative to white: the inverse of `TransferCurve.light`."""
        values = np.asarray(light, np.float64)
        if self.kind == "linear":
            return values
        values = np.maximum(values, 0.0)
        match self.kind:
            case "srgb":
                bent = (1 + _OFFSET) * values ** (1 / _EXPONENT) - _OFFSET
                return np.asarray(np.where(values <= _LAST_LIGHT, values * _SLOPE, bent))
            case "power":
                return np.asarray(values ** (1 / self._power))
        samples, lights = self._columns
        return _interpolated(values, lights, samples)

    def record(self) -> dict[str, Any]:
        """Return the fields that files record: `kind`, and `exponent` or `points` if it has any."""
        fields: dict[str, Any] = {"kind": self.kind}
        if self.exponent is not None:
            fields["exponent"] = self.exponent
        if self.points:
            fields["points"] = [list(point) for point in self.points]
        return fields

    @property
    def _power(self) -> float:
        return self.exponent or 1.0

    @property
    def _columns(self) -> tuple[Float64, Float64]:
        pairs = np.array(self.points)
        return pairs[:, 0], pairs[:, 1]

    def _check_points(self) -> None:
        if self.points[0] != (0.0, 0.0) or self.points[-1] != (1.0, 1.0):
            raise DataError("a table of a transfer curve begins with 0, 0 and ends at the white")
        for before, after in zip(self.points, self.points[1:], strict=False):
            if not (before[0] < after[0] and before[1] < after[1]):
                raise DataError(
                    f"a table of a transfer curve increases in both columns, but {after[0]:g}, "
                    f"{after[1]:g} follows {before[0]:g}, {before[1]:g} (relative to the last line)"
                )
            if not all(map(math.isfinite, after)):
                raise DataError("a table of a transfer curve needs finite numbers")


def _interpolated(values: Float64, x: Float64, y: Float64) -> Float64:
    slope = (y[-1] - y[-2]) / (x[-1] - x[-2])
    inside = np.interp(values, x, y)
    return np.asarray(np.where(values > x[-1], y[-1] + (values - x[-1]) * slope, inside))


LINEAR = TransferCurve()
SRGB = TransferCurve("srgb")
