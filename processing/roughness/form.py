"""The nominal form of a surface, which is removed before its texture is measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal

import numpy as np
from scipy.optimize import least_squares

from acquisition.files import rows_in_bands
from calibration import EstimateError
from rig import short_repr
from rig.arrays import Bool, Float64, Floating

Form = Literal[
    "none", "level", "plane", "quadric", "cubic", "quartic", "quintic", "sphere", "cylinder"
]
_Distance = Callable[[Float64, Float64], Float64]
ORDERS: Final = {"level": 0, "plane": 1, "quadric": 2, "cubic": 3, "quartic": 4, "quintic": 5}
# Pixels that show the radius of a sphere or cylinder, and radii that count as flat, in sizes of
# the area.
_SAMPLES, _FLAT = 20_000, 1e3
_ROUNDS = 10
# Tukey's constant: the efficiency is 95 % for normal deviations.
_TUKEY, _NORMAL = 4.685, 1.4826
# Condition of equations that determine nothing, in single precision.
_SINGULAR = 1e6
# Pixels of a band whose sums are computed at once.
_BAND = 1_000_000


@dataclass(frozen=True, eq=False)
class FittedForm:
    """A form that is fitted to heights.

    Parameters
    ----------
    heights
        ``(H, W)`` of the form, in the unit of the given heights; NaN where it has none.
    radius
        Radius of a sphere or cylinder, positive if it is convex toward the camera; None for others.
    """

    heights: Floating
    radius: float | None

    __repr__ = short_repr


def fit_form(heights: Floating, pixel: float, form: Form, *, robust: bool = False) -> FittedForm:
    """Fit a form by least squares.

    Polynomials are fitted to heights, spheres and cylinders to points along the normals of the form
    (total least squares).

    Parameters
    ----------
    heights
        ``(H, W)``, NaN where they are not known.
    pixel
        Distance between neighbouring pixels in the unit of the heights.
    form
        ``level`` is the mean height; ``quadric`` to ``quintic`` are polynomials of x and y of order
        2 to 5.
    robust
        Give heights that are far from the form little weight (Tukey's biweight).

    Raises
    ------
    EstimateError
        If there are too few heights, or a sphere or cylinder does not fit.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import fit_form
    >>> y, x = np.mgrid[:40, :60] * 0.1
    >>> ball = np.sqrt(10**2 - (x - 3) ** 2 - (y - 2) ** 2)
    >>> round(fit_form(ball, 0.1, "sphere").radius, 6)
    10.0
    """
    known = np.isfinite(heights)
    if form == "none":
        return FittedForm(np.zeros_like(heights), None)
    if form in ORDERS:
        return FittedForm(_polynomial(heights, known, ORDERS[form], robust), None)
    return _round_form(heights, known, pixel, form, robust)


def _polynomial(heights: Floating, known: Bool, order: int, robust: bool) -> Floating:
    powers = [(i, k) for i in range(order + 1) for k in range(order + 1 - i)]
    if np.count_nonzero(known) < 2 * len(powers):
        raise EstimateError(
            f"{np.count_nonzero(known)} known heights are too few for a polynomial of order {order}"
        )
    # Legendre polynomials over the area: products of high powers would be almost dependent.
    down, right = (
        np.polynomial.legendre.legvander(np.linspace(-1, 1, size), order).astype(heights.dtype)
        for size in heights.shape
    )
    found = np.zeros_like(heights)
    scale = np.inf
    for _ in range(_ROUNDS if robust else 1):
        equations = _Equations(order)
        for rows in rows_in_bands(heights.shape[0], heights.shape[1], _BAND):
            inside = known[rows]
            values = np.where(inside, heights[rows], 0)
            weights = _weights(values - found[rows], scale) * inside
            equations.add(down[rows], right, values, weights.astype(heights.dtype))
        factors = equations.solved(powers)
        np.matmul(down @ factors.astype(heights.dtype), right.T, out=found)
        if not robust:
            break
        deviation = heights[known]
        deviation -= found[known]
        np.abs(deviation, out=deviation)
        scale = _TUKEY * _NORMAL * float(np.median(deviation, overwrite_input=True))
        if scale == 0:
            break
    return found


def _weights(deviation: Floating, scale: float) -> Floating:
    return np.asarray(np.square(np.maximum(1 - np.square(deviation / scale), 0)))


class _Equations:
    """Normal equations of the factors of the products of two polynomials."""

    def __init__(self, order: int) -> None:
        self._order, self._count = order, order + 1
        self._products = np.zeros((self._count**2, self._count**2))
        self._sums = np.zeros((self._count, self._count))

    def add(self, down: Floating, right: Floating, values: Floating, weights: Floating) -> None:
        """Add pixels, by the polynomials of their rows and of their columns."""
        first, second = (
            np.einsum("ni,nk->nik", one, one).reshape(len(one), -1) for one in (down, right)
        )
        self._products += first.T @ weights @ second
        self._sums += down.T @ (values * weights) @ right

    def solved(self, powers: list[tuple[int, int]]) -> Float64:
        """Return the factors, ``(order + 1, order + 1)``."""
        products = self._products.reshape([self._count] * 4)
        normal = np.array([[products[i, j, k, m] for j, m in powers] for i, k in powers])
        if np.linalg.cond(normal) > _SINGULAR:
            raise EstimateError(
                f"the known heights do not determine a polynomial of order {self._order}: they are "
                "on few lines"
            )
        factors = np.zeros_like(self._sums)
        chosen = tuple(np.transpose(powers))
        factors[chosen] = np.linalg.solve(normal, self._sums[chosen])
        return factors


def _round_form(
    heights: Floating, known: Bool, pixel: float, form: str, robust: bool
) -> FittedForm:
    """Fit a sphere or a cylinder: start at the quadric, whose curvature shows side and radius."""
    rows, columns = np.nonzero(known)
    if len(rows) < _SAMPLES // 1000:
        raise EstimateError(f"{len(rows)} known heights are too few for a {form}")
    pick = slice(None, None, max(1, len(rows) // _SAMPLES))
    points = np.column_stack(
        [columns[pick] * pixel, -rows[pick] * pixel, heights[rows[pick], columns[pick]]]
    ).astype(np.float64)
    middle = points.mean(axis=0)
    points -= middle
    size = float(np.ptp(points[:, :2], axis=0).max())
    x, y, z = points.T
    matrix = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    _, a, b, xx, xy, yy = np.linalg.lstsq(matrix, z, rcond=None)[0]
    curvatures, directions = np.linalg.eigh([[2 * xx, xy], [xy, 2 * yy]])
    main = int(np.argmax(np.abs(curvatures)))
    curvature = curvatures.mean() if form == "sphere" else curvatures[main]
    if abs(curvature) * size * _FLAT < 1:
        raise EstimateError(f"the surface is too flat for a {form}: use plane")
    side = -np.sign(curvature)
    up = np.array([-a, -b, 1.0]) / np.linalg.norm([a, b, 1.0])
    radius = abs(1 / curvature)
    distance: _Distance = _from_sphere if form == "sphere" else _from_cylinder
    if form == "sphere":
        start = np.append(-side * radius * up, radius)
    else:
        along = float(np.arctan2(directions[1, 1 - main], directions[0, 1 - main]))
        start = np.array([-side * radius, 0.0, along, 0.0, radius])
    scales = np.maximum(np.abs(start), size)
    if form == "cylinder":
        scales[2:4] = 1.0
    deviation = distance(points, start)
    found = least_squares(
        partial(distance, points),
        start,
        x_scale=scales,
        loss="soft_l1" if robust else "linear",
        f_scale=_NORMAL * float(np.median(np.abs(deviation))) or 1.0,
    ).x
    whole = np.full(heights.shape, np.nan)
    row, column = np.indices(heights.shape)
    there = np.stack([column * pixel - middle[0], -row * pixel - middle[1]])
    surface = _sphere_heights if form == "sphere" else _cylinder_heights
    whole[:] = surface(there, found, side) + middle[2]
    if not np.isfinite(whole[known]).all():
        raise EstimateError(f"the {form} that fits best does not reach across the area")
    return FittedForm(whole.astype(heights.dtype), float(side * abs(found[-1])))


def _from_sphere(points: Float64, sphere: Float64) -> Float64:
    return np.asarray(np.linalg.norm(points - sphere[:3], axis=1) - sphere[3])


def _axis(cylinder: Float64) -> tuple[Float64, Float64]:
    """Return a point of the axis and its direction."""
    height, across, angle, rise, _ = cylinder
    level = np.array([-np.sin(angle), np.cos(angle), 0.0])
    axis = np.array([np.cos(angle), np.sin(angle), rise])
    return across * level + np.array([0, 0, height]), axis / np.linalg.norm(axis)


def _from_cylinder(points: Float64, cylinder: Float64) -> Float64:
    at, axis = _axis(cylinder)
    return np.asarray(np.linalg.norm(np.cross(points - at, axis), axis=1) - cylinder[4])


def _sphere_heights(at: Float64, sphere: Float64, side: float) -> Float64:
    square = sphere[3] ** 2 - (at[0] - sphere[0]) ** 2 - (at[1] - sphere[1]) ** 2
    with np.errstate(invalid="ignore"):
        return np.asarray(sphere[2] + side * np.sqrt(square))


def _cylinder_heights(at: Float64, cylinder: Float64, side: float) -> Float64:
    """Return where vertical lines meet a cylinder: a quadratic equation."""
    start, axis = _axis(cylinder)
    x, y = at[0] - start[0], at[1] - start[1]
    along = x * axis[0] + y * axis[1]
    # |p - (p . a) a|^2 = r^2 for p = (x, y, z).
    a = 1 - axis[2] ** 2
    half = -along * axis[2]
    c = x * x + y * y - along**2 - cylinder[4] ** 2
    with np.errstate(invalid="ignore"):
        return np.asarray(start[2] + (-half + side * np.sqrt(half**2 - a * c)) / a)
