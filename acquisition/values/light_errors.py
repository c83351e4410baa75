"""How sure calibrated lights are: covariances, standard deviations and residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from rig import pluralize, short_repr
from rig.arrays import Float64, Int64

# Rounding errors of a computed covariance, relative to its largest element.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class LightErrors:
    """Errors of N calibrated lights, each of them if known.

    A row of NaN (0 for `spheres`) means that the value of this light is not known; None means that
    the values of all lights are not known.

    Parameters
    ----------
    covariances
        Of positions ``(N, 3, 3)`` in mm^2, in the house frame. Of directions ``(N, 2, 2)`` in
        rad^2, in the basis of `tangent_basis`. Symmetric and positive semidefinite.
    intensity_std
        ``(N, 3)`` or ``(N,)`` standard deviations of the intensities, in their unit.
    axis_std_deg
        ``(N,)`` standard deviations of the axes of near lights in degrees, in any direction at
        right angles to the axis.
    mu_std
        ``(N,)`` standard deviations of `mu`.
    residual_px
        ``(N,)`` rms distances between the used highlights and those that the lights explain.
    spheres
        ``(N,)`` numbers of spheres whose highlights were used.

    Raises
    ------
    DataError
        When `Lights` are created with errors of other shapes, an infinite or negative standard
        deviation, or a matrix that is not a covariance. The message names the light.
    """

    covariances: Float64 | None = None
    intensity_std: Float64 | None = None
    axis_std_deg: Float64 | None = None
    mu_std: Float64 | None = None
    residual_px: Float64 | None = None
    spheres: Int64 | None = None

    __repr__ = short_repr

    def checked(self, ids: Sequence[str], *, near: bool) -> LightErrors | None:
        """Return the errors as arrays for lights with these ids, None if no value is known.

        Raises
        ------
        DataError
            If they do not belong to such lights or are invalid, see `LightErrors`.
        """
        count = len(ids)
        strength = self.intensity_std
        if strength is not None and np.ndim(strength) == 1:
            strength = np.repeat(np.asarray(strength, np.float64)[:, None], 3, axis=1)
        if not near and (self.axis_std_deg is not None or self.mu_std is not None):
            raise DataError("only lights with positions have errors of axis and mu")
        errors = LightErrors(
            _covariances(self.covariances, ids, 3 if near else 2),
            _deviations(strength, ids, (count, 3), "standard deviation of the intensity"),
            _deviations(self.axis_std_deg, ids, (count,), "standard deviation of the axis"),
            _deviations(self.mu_std, ids, (count,), "standard deviation of mu"),
            _deviations(self.residual_px, ids, (count,), "residual"),
            _counts(self.spheres, ids),
        )
        known = any(getattr(errors, field.name) is not None for field in fields(errors))
        return errors if known else None

    def take(self, indices: Sequence[int]) -> LightErrors:
        """Return the errors of the lights with these indices, in this order."""
        arrays = (getattr(self, field.name) for field in fields(self))
        return LightErrors(*(None if one is None else one[list(indices)] for one in arrays))

    def of_directions(self, positions_mm: Float64) -> LightErrors:
        """Return the errors of the directions from the origin toward positions ``(N, 3)``."""
        covariances = None
        if self.covariances is not None:
            distance = np.linalg.norm(positions_mm, axis=1)[:, None, None]
            basis = tangent_basis(positions_mm) / distance
            covariances = basis @ self.covariances @ basis.transpose(0, 2, 1)
        return replace(self, covariances=covariances, axis_std_deg=None, mu_std=None)


def tangent_basis(directions: npt.ArrayLike) -> Float64:
    """Return two unit vectors at right angles to each direction, as rows: ``(N, 2, 3)``.

    They are X and Y after the smallest rotation that turns Z into the direction ``(x, y, z)``::

        e1 = (1 - x^2 / (1 + z), -x y / (1 + z), -x)
        e2 = (-x y / (1 + z), 1 - y^2 / (1 + z), -y)

    For a direction with z < 0 they are X and -Y after the smallest rotation that turns -Z into it
    (Duff et al., Building an orthonormal basis, revisited, 2017). ``e1 x e2`` is the direction. An
    error of ``a e1 + b e2`` has the coordinates (a, b), in radians.

    Parameters
    ----------
    directions
        ``(N, 3)`` vectors of any length but zero.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition.values import tangent_basis
    >>> np.cross(*tangent_basis([[1.0, 2.0, 2.0]])[0]).round(3)
    array([0.333, 0.667, 0.667])
    """
    vectors = np.asarray(directions, np.float64)
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    x, y, z = unit.T
    sign = np.where(z < 0, -1.0, 1.0)
    shrink = 1 / (1 + np.abs(z))
    first = np.stack([1 - x**2 * shrink, -x * y * shrink, -sign * x], axis=1)
    second = np.stack([-sign * x * y * shrink, sign * (1 - y**2 * shrink), -y], axis=1)
    return np.stack([first, second], axis=1)


def _covariances(value: Float64 | None, ids: Sequence[str], size: int) -> Float64 | None:
    if value is None:
        return None
    matrices = np.array(value, np.float64)
    if matrices.shape != (len(ids), size, size):
        kind = "positions" if size == 3 else "directions"
        raise DataError(
            f"covariances of shape {matrices.shape}: {pluralize(len(ids), 'light')} with {kind} "
            f"need {len(ids)} x {size} x {size} numbers"
        )
    for name, matrix in zip(ids, matrices, strict=True):
        if np.isnan(matrix).all():
            continue
        if not np.isfinite(matrix).all():
            raise DataError(f"the covariance of light {name} is not finite")
        allowed = _ROUNDING * np.abs(matrix).max()
        if np.abs(matrix - matrix.T).max() > allowed:
            raise DataError(f"the covariance of light {name} is not symmetric")
        if np.linalg.eigvalsh(matrix).min() < -allowed:
            raise DataError(
                f"the covariance of light {name} has a negative eigenvalue, so it is no covariance"
            )
    return _known((matrices + matrices.transpose(0, 2, 1)) / 2)


def _deviations(
    value: Float64 | None, ids: Sequence[str], shape: tuple[int, ...], name: str
) -> Float64 | None:
    if value is None:
        return None
    array = np.array(value, np.float64)
    if array.shape != shape:
        raise DataError(f"{name}: values of shape {array.shape} for {pluralize(len(ids), 'light')}")
    rows = array.reshape(len(ids), -1)
    unknown = np.isnan(rows).all(axis=1)
    bad = ~(unknown | (np.isfinite(rows) & (rows >= 0)).all(axis=1))
    if bad.any():
        light = ids[int(np.argmax(bad))]
        raise DataError(f"the {name} of light {light} is not a finite number of at least 0")
    return _known(array)


def _known(array: Float64) -> Float64 | None:
    return None if np.isnan(array).all() else array


def _counts(value: Int64 | None, ids: Sequence[str]) -> Int64 | None:
    if value is None:
        return None
    array = np.asarray(value)
    if array.shape != (len(ids),) or array.dtype.kind not in "iu" or np.any(array < 0):
        raise DataError(
            f"spheres: {pluralize(len(ids), 'light')} need {len(ids)} whole numbers of at least 0"
        )
    return array.astype(np.int64) if array.any() else None
