"""Objects as height fields z(x, y): exact heights, exact gradients, and an outline."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, ClassVar, Literal

import numba
import numpy as np

from acquisition import DataError
from rig import in_threads
from rig.arrays import Bool, Float64
from simulator.shapes.body import BodyHits, HeightGrid
from simulator.shapes.field_trace import FieldBounds, meet_field
from simulator.shapes.ranges import check_positive

_WAVES = 24  # plane waves in band noise, enough to look isotropic
_SAMPLES = 513  # samples along each side to find the extremes of a field
_STEEPER = 1.3  # safety factor on the steepest gradient of the samples
_MOST_SAMPLES = 16_000_000


@dataclass(frozen=True)
class Surface(ABC):
    """An object on the board: a height field inside an outline.

    Parameters
    ----------
    radius_mm
        Radius of the outline around the frame's origin. The board at z = 0 begins outside it; the
        wall between object and board is not rendered.
    outline
        ``round``, or ``square`` for the square inside the circle, with sides along x and y.

    Raises
    ------
    DataError
        If a parameter is not a finite number or a length is not positive. The message names the
        parameter.
    """

    radius_mm: float
    outline: Literal["round", "square"] = field(default="round", kw_only=True)
    # Further parameters that must be positive.
    _lengths: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, int | float) and not math.isfinite(value):
                raise DataError(
                    f"{type(self).__name__}: {item.name} is {value}, it must be a finite number"
                )
        if self.outline not in ("round", "square"):
            raise DataError(
                f"{type(self).__name__}: outline is {self.outline!r}, it must be round or square"
            )
        self._positive("radius_mm", *self._lengths)

    def _positive(self, *names: str) -> None:
        check_positive(type(self).__name__, **{name: getattr(self, name) for name in names})

    @abstractmethod
    def evaluate(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64, Float64]:
        """Return height and gradient.

        Parameters
        ----------
        x_mm, y_mm
            Positions, arrays of one shape. They may be outside the outline: the field continues
            there, so that a search may step over the edge.

        Returns
        -------
        z_mm, dz_dx, dz_dy
            Height above the board and its exact derivatives, with the same shape.
        """

    @cached_property
    def bounds(self) -> FieldBounds:
        """Bounds of height and gradient within the outline, from samples plus a margin."""
        span = np.linspace(-self.radius_mm, self.radius_mm, _SAMPLES)
        x, y = np.meshgrid(span, span)
        within = x**2 + y**2 <= self.radius_mm**2
        z, zx, zy = self.evaluate(x[within], y[within])
        steepest = _STEEPER * float(np.hypot(zx, zy).max())
        # Half the diagonal between samples.
        margin = steepest * float(span[1] - span[0]) / math.sqrt(2)
        return FieldBounds(float(z.min()) - margin, float(z.max()) + margin, steepest)

    @property
    def top_mm(self) -> float:
        """Upper bound of the object's height above the board."""
        return self.bounds.top_mm

    def inside(self, x_mm: Float64, y_mm: Float64) -> Bool:
        """Return which positions are within the outline, including its edge."""
        within: Bool
        if self.outline == "square":
            half = self.radius_mm / math.sqrt(2)
            within = np.maximum(np.abs(x_mm), np.abs(y_mm)) <= half
        else:
            within = x_mm**2 + y_mm**2 <= self.radius_mm**2
        return within

    def trace(self, origins_mm: Float64, directions: Float64) -> BodyHits:
        """Find the first hits of rays on the surface.

        Parameters
        ----------
        origins_mm, directions
            ``(..., 3)`` arrays that broadcast against each other.

        Returns
        -------
        BodyHits
            Hits, to 1e-9 mm. If the surface hides parts of itself, a grazing hit may be missed if
            it is shorter than 1e-3 of the ray's path from top to bottom of the surface.

        Raises
        ------
        DataError
            If the surface's `bounds` are not finite.
        """
        origins, directions = np.broadcast_arrays(origins_mm, directions)
        shape = origins.shape[:-1]
        origins, directions = origins.reshape(-1, 3), directions.reshape(-1, 3)
        t, zx, zy = meet_field(
            self.evaluate,
            self.radius_mm,
            self.bounds,
            origins,
            directions,
            square=self.outline == "square",
        )
        hit = np.isfinite(t)
        points = origins + np.where(hit, t, 0.0)[:, None] * directions
        hit &= self.inside(points[:, 0], points[:, 1])
        length = np.sqrt(1 + zx**2 + zy**2)
        normals = np.stack([-zx / length, -zy / length, 1 / length], axis=1)
        points[~hit], normals[~hit] = 0.0, 0.0
        return BodyHits(points.reshape(*shape, 3), normals.reshape(*shape, 3), hit.reshape(shape))

    def shadow_caster(self, step_mm: float) -> HeightGrid:
        """Sample the heights for casting shadows.

        Parameters
        ----------
        step_mm
            Distance between samples.

        Returns
        -------
        HeightGrid
            Grid that is symmetric about the origin and two steps wider than the outline on each
            side; heights outside the outline are 0.

        Raises
        ------
        DataError
            If the step is not positive, or so small that the grid has too many samples.
        """
        if not (math.isfinite(step_mm) and step_mm > 0):
            raise DataError(f"the step of a shadow grid is {step_mm} mm, it must be positive")
        reach = math.ceil(self.radius_mm / step_mm) + 2
        if (2 * reach + 1) ** 2 > _MOST_SAMPLES:
            raise DataError(
                f"a shadow grid with a step of {step_mm:g} mm has {(2 * reach + 1) ** 2} samples, "
                f"more than {_MOST_SAMPLES}: use a larger step"
            )
        span = step_mm * np.arange(-reach, reach + 1)
        heights = np.zeros((span.size, span.size), np.float32)
        # In bands of rows, because the gradients of all samples would need too much memory.
        for band in np.array_split(np.arange(span.size), max(1, span.size**2 // 1_000_000)):
            x, y = np.meshgrid(span, span[band])
            within = self.inside(x, y)
            part = np.zeros(x.shape, np.float32)
            part[within] = self.evaluate(x[within], y[within])[0]
            heights[band] = part
        return HeightGrid((-reach * step_mm, -reach * step_mm), step_mm, heights)


def drawn(
    kernel: Callable[..., None], x_mm: Float64, y_mm: Float64, *figure: Any, unit_mm: float = 1.0
) -> Float64:
    """Return ``(3, ...)`` height and gradient of a kernel at positions x and y of one shape.

    The kernel receives x and y, ``(n,)`` in units of ``unit_mm``, the figure that it draws, and an
    array of zeros ``(3, n)`` for its result.
    """
    x, y = np.broadcast_arrays(x_mm, y_mm)
    out = np.zeros((3, x.size))
    places = (np.ascontiguousarray(v, np.float64).ravel() / unit_mm for v in (x, y))
    in_threads(kernel, x.size, *places, *figure, out)
    return out.reshape(3, *x.shape)


@dataclass(frozen=True)
class Plane(Surface):
    """A flat or tilted plane, ``z = height + slope_x x + slope_y y``."""

    height_mm: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64, Float64]:
        """Return height and gradient at positions, see `Surface`."""
        z = self.height_mm + self.slope_x * x_mm + self.slope_y * y_mm
        return z, np.full_like(z, self.slope_x), np.full_like(z, self.slope_y)

    @cached_property
    def bounds(self) -> FieldBounds:
        """Lowest and highest height, and the steepest slope."""
        slope = math.hypot(self.slope_x, self.slope_y)
        rise = slope * self.radius_mm
        return FieldBounds(self.height_mm - rise, self.height_mm + rise, slope)


@dataclass(frozen=True)
class SphericalCap(Surface):
    """A dome that meets the board at the outline: the top ``height_mm`` of a sphere.

    If the height equals the radius, the cap is a hemisphere and vertical at its rim.
    """

    height_mm: float = 10.0
    _lengths = ("height_mm",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.height_mm > self.radius_mm:
            raise DataError(
                f"SphericalCap: height_mm {self.height_mm} must not exceed radius_mm "
                f"{self.radius_mm}: a camera above cannot see more than a hemisphere"
            )

    @property
    def sphere_radius_mm(self) -> float:
        """Radius of the sphere of which the cap is a part."""
        return (self.radius_mm**2 + self.height_mm**2) / (2 * self.height_mm)

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64, Float64]:
        """Return height and gradient at positions, see `Surface`."""
        sphere = self.sphere_radius_mm
        squared = x_mm**2 + y_mm**2
        on_cap = squared <= self.radius_mm**2
        # The rim of a hemisphere is vertical; the gradient is kept finite there.
        least = (1e-12 * sphere) ** 2
        rise = np.sqrt(np.where(on_cap, np.maximum(sphere**2 - squared, least), sphere**2))
        z = np.where(on_cap, rise - (sphere - self.height_mm), 0.0)
        return z, np.where(on_cap, -x_mm / rise, 0.0), np.where(on_cap, -y_mm / rise, 0.0)

    @cached_property
    def bounds(self) -> FieldBounds:
        """Lowest and highest height, and the steepest slope."""
        upright = self.height_mm == self.radius_mm
        rim = math.inf if upright else self.radius_mm / (self.sphere_radius_mm - self.height_mm)
        return FieldBounds(0.0, self.height_mm, rim)

    def trace(self, origins_mm: Float64, directions: Float64) -> BodyHits:
        """Find the first hits of rays on the cap in closed form (see `Surface.trace`)."""
        origins, directions = np.broadcast_arrays(origins_mm, directions)
        centre = np.array([0.0, 0.0, self.height_mm - self.sphere_radius_mm])
        offset = origins - centre
        a, b = (directions**2).sum(axis=-1), (directions * offset).sum(axis=-1)
        root = b * b - a * ((offset**2).sum(axis=-1) - self.sphere_radius_mm**2)
        t = (-b - np.sqrt(np.clip(root, 0.0, None))) / a
        points = origins + t[..., None] * directions
        hit = (root >= 0) & (t > 0) & (points[..., 2] >= 0)
        hit &= self.inside(points[..., 0], points[..., 1])
        normals = (points - centre) / self.sphere_radius_mm
        keep = hit[..., None]
        return BodyHits(np.where(keep, points, 0.0), np.where(keep, normals, 0.0), hit)


@dataclass(frozen=True)
class Ripples(Surface):
    """Circular waves around the origin, between z = 0 and twice the amplitude."""

    amplitude_mm: float = 0.3
    wavelength_mm: float = 8.0
    _lengths = ("amplitude_mm", "wavelength_mm")

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64, Float64]:
        """Return height and gradient at positions, see `Surface`."""
        k = 2 * math.pi / self.wavelength_mm
        r = np.hypot(x_mm, y_mm)
        z = self.amplitude_mm * (1 + np.cos(k * r))
        # sinc gives the limit of sin(kr)/r at the centre.
        steep = -self.amplitude_mm * k * k * np.sinc(k * r / math.pi)
        return z, steep * x_mm, steep * y_mm

    @cached_property
    def bounds(self) -> FieldBounds:
        """Lowest and highest height, and the steepest slope."""
        slope = 2 * math.pi * self.amplitude_mm / self.wavelength_mm
        return FieldBounds(0.0, 2 * self.amplitude_mm, slope)


@dataclass(frozen=True)
class BandNoise(Surface):
    """Random waves of one wavelength in all directions, with the mean height ``height_mm``."""

    rms_mm: float = 0.1
    wavelength_mm: float = 8.0
    height_mm: float = 1.0
    seed: int = 0
    _lengths = ("rms_mm", "wavelength_mm")

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64, Float64]:
        """Return height and gradient at positions, see `Surface`."""
        waves = random_waves(self.wavelength_mm, self.seed, _WAVES)
        gain = self.rms_mm * math.sqrt(2 / _WAVES)
        z, zx, zy = drawn(add_waves, x_mm, y_mm, waves, gain)
        return self.height_mm + z, zx, zy

    @cached_property
    def bounds(self) -> FieldBounds:
        """Lowest and highest height, and the steepest slope."""
        most = self.rms_mm * math.sqrt(2 * _WAVES)
        slope = most * 2 * math.pi / self.wavelength_mm
        return FieldBounds(self.height_mm - most, self.height_mm + most, slope)


def random_waves(wavelength_mm: float, seed: int, count: int) -> Float64:
    """Return ``(count, 3)`` wave numbers kx, ky (rad/mm) and phases of waves of one wavelength.

    The directions are uniform over the half circle plus a random offset, so that even a few waves
    look isotropic.
    """
    rng = np.random.default_rng(seed)
    angle = (np.arange(count) + rng.uniform(-0.5, 0.5, count)) * math.pi / count
    k = 2 * math.pi / wavelength_mm
    phase = rng.uniform(0, 2 * math.pi, count)
    return np.stack([k * np.cos(angle), k * np.sin(angle), phase], axis=1)


@numba.njit(nogil=True, cache=True)
def add_waves(
    first: int, last: int, x: Float64, y: Float64, waves: Float64, gain: float, out: Float64
) -> None:
    """Add the height and gradient of plane waves to ``out`` (3, n)."""
    for i in range(first, last):
        for j in range(len(waves)):
            kx, ky, phase = waves[j, 0], waves[j, 1], waves[j, 2]
            angle = kx * x[i] + ky * y[i] + phase
            slope = -gain * math.sin(angle)
            out[0, i] += gain * math.cos(angle)
            out[1, i] += kx * slope
            out[2, i] += ky * slope
