"""Objects as height fields z(x, y): exact heights, exact gradients, and an outline."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from acquisition import DataError

Array = npt.NDArray[np.float64]

_WAVES = 24  # plane waves in band noise: enough that no direction stands out


@dataclass(frozen=True)
class Surface(ABC):
    """An object on the backing board: a height field inside a round outline.

    Parameters
    ----------
    radius_mm
        Radius of the outline around the frame's origin. The board at z = 0 begins outside it;
        the wall between the two is not drawn.

    Raises
    ------
    DataError
        If a parameter is not a finite number or a length is not positive. The message names it.
    """

    radius_mm: float

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, int | float) and not math.isfinite(value):
                raise DataError(f"{type(self).__name__}: {item.name} is {value}, not a number")
        self._positive("radius_mm")

    def _positive(self, *names: str) -> None:
        for name in names:
            if getattr(self, name) <= 0:
                raise DataError(
                    f"{type(self).__name__}: {name} is {getattr(self, name)}, it must be positive"
                )

    @abstractmethod
    def evaluate(self, x_mm: Array, y_mm: Array) -> tuple[Array, Array, Array]:
        """Return height and gradient.

        Parameters
        ----------
        x_mm, y_mm
            Positions, any one shape. Positions outside the outline are allowed: the field goes on
            there, so that a search may step over the edge.

        Returns
        -------
        z_mm, dz_dx, dz_dy
            Height above the board and its exact derivatives, same shape.
        """

    def inside(self, x_mm: Array, y_mm: Array) -> npt.NDArray[np.bool_]:
        """Return which positions lie within the outline, its edge included."""
        within: npt.NDArray[np.bool_] = x_mm**2 + y_mm**2 <= self.radius_mm**2
        return within


@dataclass(frozen=True)
class Plane(Surface):
    """A flat or tilted plane, ``z = height + slope_x x + slope_y y``."""

    height_mm: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0

    def evaluate(self, x_mm: Array, y_mm: Array) -> tuple[Array, Array, Array]:
        z = self.height_mm + self.slope_x * x_mm + self.slope_y * y_mm
        return z, np.full_like(z, self.slope_x), np.full_like(z, self.slope_y)


@dataclass(frozen=True)
class SphericalCap(Surface):
    """A dome that meets the board at the outline: the top ``height_mm`` of a sphere."""

    height_mm: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._positive("height_mm")
        if self.height_mm >= self.radius_mm:
            raise DataError(
                f"SphericalCap: height_mm {self.height_mm} must be less than radius_mm "
                f"{self.radius_mm}: a camera above cannot see more than half a sphere"
            )

    @property
    def sphere_radius_mm(self) -> float:
        """Radius of the sphere that the cap is cut from."""
        return (self.radius_mm**2 + self.height_mm**2) / (2 * self.height_mm)

    def evaluate(self, x_mm: Array, y_mm: Array) -> tuple[Array, Array, Array]:
        sphere = self.sphere_radius_mm
        squared = x_mm**2 + y_mm**2
        on_cap = squared <= self.radius_mm**2
        rise = np.sqrt(np.where(on_cap, sphere**2 - squared, sphere**2))
        z = np.where(on_cap, rise - (sphere - self.height_mm), 0.0)
        return z, np.where(on_cap, -x_mm / rise, 0.0), np.where(on_cap, -y_mm / rise, 0.0)


@dataclass(frozen=True)
class Ripples(Surface):
    """Circular waves around the origin, between z = 0 and twice the amplitude."""

    amplitude_mm: float = 0.3
    wavelength_mm: float = 8.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._positive("amplitude_mm", "wavelength_mm")

    def evaluate(self, x_mm: Array, y_mm: Array) -> tuple[Array, Array, Array]:
        k = 2 * math.pi / self.wavelength_mm
        r = np.hypot(x_mm, y_mm)
        z = self.amplitude_mm * (1 + np.cos(k * r))
        # sin(kr)/r by sinc: it has a limit at the centre.
        steep = -self.amplitude_mm * k * k * np.sinc(k * r / math.pi)
        return z, steep * x_mm, steep * y_mm


@dataclass(frozen=True)
class BandNoise(Surface):
    """Random waves of one wavelength in all directions, around z = ``height_mm``."""

    rms_mm: float = 0.1
    wavelength_mm: float = 8.0
    height_mm: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._positive("rms_mm", "wavelength_mm")

    def evaluate(self, x_mm: Array, y_mm: Array) -> tuple[Array, Array, Array]:
        z, zx, zy = np.full_like(x_mm, self.height_mm), np.zeros_like(x_mm), np.zeros_like(x_mm)
        gain = self.rms_mm * math.sqrt(2 / _WAVES)
        for kx, ky, phase in random_waves(self.wavelength_mm, self.seed):
            angle = kx * x_mm + ky * y_mm + phase
            slope = -gain * np.sin(angle)
            z += gain * np.cos(angle)
            zx += kx * slope
            zy += ky * slope
        return z, zx, zy


def random_waves(wavelength_mm: float, seed: int, count: int = _WAVES) -> Array:
    """Return ``(count, 3)`` wave numbers kx, ky (rad/mm) and phases of waves of one length.

    The directions are spread evenly over the half circle and then shaken, so that a few waves
    already look the same from all sides.
    """
    rng = np.random.default_rng(seed)
    angle = (np.arange(count) + rng.uniform(-0.5, 0.5, count)) * math.pi / count
    k = 2 * math.pi / wavelength_mm
    phase = rng.uniform(0, 2 * math.pi, count)
    return np.stack([k * np.cos(angle), k * np.sin(angle), phase], axis=1)
