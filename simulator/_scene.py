"""A scene: an object on a backing board, chrome spheres, near lights, a camera and its sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError, Lights, NoiseModel
from simulator._optics import check_camera
from simulator._surface import Surface, random_waves

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Paint:
    """An albedo that wanders smoothly between two values, or one value where both are equal.

    Parameters
    ----------
    low, high
        Bounds, ``0 <= low <= high <= 1``.
    wavelength_mm
        Typical length of the variation.
    seed
        Of the pattern.
    """

    low: float
    high: float
    wavelength_mm: float = 60.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.low <= self.high <= 1 or not self.wavelength_mm > 0:
            raise DataError(
                f"an albedo runs from low to high within 0..1 over a positive wavelength, "
                f"not {self.low}..{self.high} over {self.wavelength_mm} mm"
            )

    def evaluate(self, x_mm: Array, y_mm: Array) -> Array:
        """Return the albedo at positions of any one shape."""
        waves = random_waves(self.wavelength_mm, self.seed, count=5)
        swing = sum(np.cos(kx * x_mm + ky * y_mm + phase) for kx, ky, phase in waves)
        # Five waves seldom meet: tanh spreads their sum to the bounds and never past them.
        albedo: Array = self.low + (self.high - self.low) * (0.5 + 0.5 * np.tanh(0.7 * swing))
        return albedo


@dataclass(frozen=True)
class ChromeSphere:
    """A mirror sphere.

    Parameters
    ----------
    centre_mm
        Centre in the house frame; a sphere that rests on the board has ``z = radius_mm``.
    radius_mm
        Greater than 0.
    reflectance
        Fraction of the light that is mirrored, 0 to 1, the same at all angles.
    """

    centre_mm: tuple[float, float, float]
    radius_mm: float
    reflectance: float = 0.6

    def __post_init__(self) -> None:
        if len(self.centre_mm) != 3 or not all(math.isfinite(v) for v in self.centre_mm):
            raise DataError(f"a sphere centre of {self.centre_mm} is not three finite numbers")
        if not (math.isfinite(self.radius_mm) and self.radius_mm > 0):
            raise DataError(f"a sphere radius of {self.radius_mm} mm is not a positive length")
        if not 0 <= self.reflectance <= 1:
            raise DataError(f"a sphere reflectance of {self.reflectance} is not within 0..1")


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything the renderer needs, checked.

    Parameters
    ----------
    surface
        The object, or None for a bare board.
    lights
        Near lights. An intensity is the irradiance at the origin on a surface that faces the
        light; the mean of its three channels is used, the camera is monochrome.
    camera
        A pinhole without distortion, with a working distance.
    noise
        The sensor, passed on to the virtual camera; the renderer itself is without noise.
    electrons_per_us
        Signal of a white Lambertian surface (albedo 1) under irradiance 1: the exposure scale.
    paint
        Albedo of the object.
    board_albedo, board_radius_mm
        The board is a disc at z = 0 around the origin; beyond it all is black.
    spheres
        Chrome spheres, beside the object and beside each other.
    ambient
        Even irradiance from the room, on the scale of the intensities.
    surroundings
        What a sphere mirrors where neither board nor LED is, as an albedo under the LED's
        irradiance at the origin.
    led_radius_mm
        Radius of the luminous disc of an LED.
    psf_sigma_px
        Gaussian blur of the lens, applied to the mirrored LEDs only.

    Raises
    ------
    DataError
        If a value is out of range, a camera or LED is inside or below something, or two things
        overlap.
    """

    surface: Surface | None
    lights: Lights
    camera: CameraModel
    noise: NoiseModel
    electrons_per_us: float
    paint: Paint
    board_albedo: float = 0.02
    board_radius_mm: float = 260.0
    spheres: tuple[ChromeSphere, ...] = ()
    ambient: float = 0.002
    surroundings: float = 0.004
    led_radius_mm: float = 2.0
    psf_sigma_px: float = 0.7

    def __post_init__(self) -> None:
        check_camera(self.camera)
        for name in ("electrons_per_us", "board_radius_mm", "led_radius_mm", "psf_sigma_px"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise DataError(f"scene: {name} is {value}, it must be positive")
        for name in ("board_albedo", "ambient", "surroundings"):
            if not 0 <= getattr(self, name) <= 1:
                raise DataError(f"scene: {name} is {getattr(self, name)}, it must be within 0..1")
        self._check_spheres()
        self._check_camera_place()
        self._check_lights()

    def _check_spheres(self) -> None:
        for i, sphere in enumerate(self.spheres):
            x, y, z = sphere.centre_mm
            if z < sphere.radius_mm - 1e-9:
                raise DataError(
                    f"sphere {i} is sunk into the board: raise its centre to its radius"
                )
            apart = math.hypot(x, y) - sphere.radius_mm
            if self.surface is not None and apart < self.surface.radius_mm:
                raise DataError(f"sphere {i} overlaps the object: move it outward")
        for (i, a), (j, b) in combinations(enumerate(self.spheres), 2):
            if math.dist(a.centre_mm, b.centre_mm) < a.radius_mm + b.radius_mm:
                raise DataError(f"spheres {i} and {j} overlap: move them apart")

    def _check_camera_place(self) -> None:
        height = float(self.camera.working_distance_mm or 0.0)
        if self.surface is not None:
            span = np.linspace(-self.surface.radius_mm, self.surface.radius_mm, 65)
            x, y = np.meshgrid(span, span)
            top = float(self.surface.evaluate(x, y)[0][self.surface.inside(x, y)].max())
            if top >= height:
                raise DataError(
                    f"the camera at {height:g} mm is inside the object, {top:g} mm high: "
                    f"raise the working distance"
                )
        for i, sphere in enumerate(self.spheres):
            if sphere.centre_mm[2] + sphere.radius_mm >= height:
                raise DataError(f"sphere {i} reaches the camera: raise the working distance")

    def _check_lights(self) -> None:
        positions, axes = self.lights.positions_mm, self.lights.axes
        if positions is None or axes is None:
            raise DataError("a simulated scene needs lights with positions")
        for name, place, axis in zip(self.lights.ids, positions, axes, strict=True):
            floor = 0.0
            if self.surface is not None:
                x, y = place[:1], place[1:2]
                if self.surface.inside(x, y)[0]:
                    floor = max(floor, float(self.surface.evaluate(x, y)[0][0]))
            if place[2] <= floor:
                raise DataError(f"LED {name} is below the surface: raise its position")
            if place @ axis >= 0:
                raise DataError(f"LED {name} shines away from the object: turn its axis")
            for i, sphere in enumerate(self.spheres):
                if math.dist(place, sphere.centre_mm) <= sphere.radius_mm:
                    raise DataError(f"LED {name} is inside sphere {i}: move one of them")

    def inside(self, x_mm: Array, y_mm: Array) -> npt.NDArray[np.bool_]:
        """Return which positions lie within the object's outline: none without an object."""
        if self.surface is None:
            return np.zeros(x_mm.shape, np.bool_)
        return self.surface.inside(x_mm, y_mm)

    def albedo(self, x_mm: Array, y_mm: Array, on_object: npt.NDArray[np.bool_]) -> Array:
        """Return the albedo at positions of the object and of the board, 0 beyond the board."""
        on_board = x_mm**2 + y_mm**2 <= self.board_radius_mm**2
        board = np.where(on_board, self.board_albedo, 0.0)
        return np.where(on_object, self.paint.evaluate(x_mm, y_mm), board)

    @property
    def irradiance(self) -> Array:
        """``(N,)`` irradiance of each LED at the origin, the mean over colours."""
        intensities: Array = np.asarray(self.lights.intensities).mean(axis=1)
        return intensities

    @property
    def axial_intensity(self) -> Array:
        """``(N,)`` radiant intensity of each LED along its axis, irradiance times mm^2."""
        positions = np.asarray(self.lights.positions_mm)
        axes, mu = np.asarray(self.lights.axes), np.asarray(self.lights.mu)
        squared = (positions**2).sum(axis=1)
        cosine = -(positions * axes).sum(axis=1) / np.sqrt(squared)
        intensity: Array = self.irradiance * squared / cosine**mu
        return intensity

    @property
    def sphere_table(self) -> Array:
        """``(S, 5)`` rows of centre, radius and reflectance."""
        rows = [(*s.centre_mm, s.radius_mm, s.reflectance) for s in self.spheres]
        return np.array(rows, np.float64).reshape(-1, 5)
