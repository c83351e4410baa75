"""A scene: an object on a board, chrome spheres, clutter, lights and a camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from acquisition import CameraModel, DataError, Lights, NoiseModel
from rig import pluralize
from rig.arrays import Bool, Float32, Float64, Int64
from simulator.scene.clutter import Ball, Clutter
from simulator.scene.lamps import Lamps
from simulator.scene.lens import Lens
from simulator.scene.reflectance import Lambert, Material
from simulator.shapes.body import Body
from simulator.shapes.patterns import Even, Pattern
from simulator.shapes.ranges import check_positive, check_within
from simulator.shapes.surface import Surface

_MOST_PARTS = 1024
_RINGS, _SPOKES = 12, 48
# Steepest relief of the board that a ray meets only once at any usual field angle.
_STEEPEST_RELIEF = 2.0


@dataclass(frozen=True)
class ChromeSphere:
    """A mirror sphere.

    Parameters
    ----------
    centre_mm
        Centre in the house frame; a sphere on the board has ``z = radius_mm``.
    radius_mm
        Radius, greater than 0.
    reflectance
        Fraction of the light that is mirrored, 0 to 1, the same at all angles.

    Raises
    ------
    DataError
        If a value is out of range.
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
    """Description of everything that the renderer needs, with its values checked.

    Parameters
    ----------
    body
        The object, or None for a bare board.
    lights
        Near or distant lights. An intensity is the irradiance at the origin on a surface that
        faces the light. A monochrome camera sees the mean over the three channels of intensity
        times albedo; a pixel of a Bayer mosaic sees one channel.
    lens
        Lens and image size of the camera.
    noise
        Model of the sensor, for the virtual camera; the renderer itself adds no noise.
    electrons_per_us
        Signal of a white Lambertian surface (albedo 1) under irradiance 1: the exposure scale.
    pattern, material
        Albedo and reflectance of the object.
    board, board_radius_mm
        Albedo and radius of the board, a Lambertian disc at z = 0 around the origin; everything
        beyond it is black.
    spheres
        Chrome spheres that overlap neither the object nor each other.
    clutter
        Balls that are no mirrors, and boxes. They overlap neither the object nor a sphere.
    relief
        Relief of the board, a surface without its outline, or None. Its highest point is at z = 0,
        so that spheres rest on it. It casts no shadows, and spheres mirror it as a flat picture.
    ambient
        Uniform irradiance from the room, on the scale of the intensities.
    surroundings
        Brightness of the rest of the room as mirrored by a sphere, as an albedo under the LED's
        irradiance at the origin.
    led_radius_mm
        Radius of the luminous disc of an LED; distant lights are points.
    shadows
        If False, the object casts no shadows; attached shadows and those of the spheres remain.
    soft_shadow_samples
        Number of points on an LED's disc for which shadows are computed; 1 for hard shadows.
    lamps
        Behaviour of the LEDs over time, for the virtual camera.

    Raises
    ------
    DataError
        If a value is out of range, a camera or light is inside or below a surface, or two objects
        overlap.
    """

    body: Body | None
    lights: Lights
    lens: Lens
    noise: NoiseModel
    electrons_per_us: float
    pattern: Pattern = field(default_factory=lambda: Even(1.0))
    material: Material = field(default_factory=Lambert)
    board: Pattern = field(default_factory=lambda: Even(0.02))
    board_radius_mm: float = 260.0
    spheres: tuple[ChromeSphere, ...] = ()
    clutter: tuple[Clutter, ...] = ()
    relief: Surface | None = None
    ambient: float = 0.002
    surroundings: float = 0.004
    led_radius_mm: float = 2.0
    shadows: bool = True
    soft_shadow_samples: int = 1
    lamps: Lamps = field(default_factory=Lamps)

    def __repr__(self) -> str:
        height, width = self.lens.size
        body = "no body" if self.body is None else type(self.body).__name__
        lights, spheres = len(self.lights), len(self.spheres)
        counts = f"{pluralize(lights, 'light')}, {pluralize(spheres, 'sphere')}"
        if self.clutter:
            counts += f", {pluralize(len(self.clutter), 'piece')} of clutter"
        return f"Scene({body}, {counts}, {width} x {height} px)"

    def __post_init__(self) -> None:
        check_positive(
            "scene",
            electrons_per_us=self.electrons_per_us,
            board_radius_mm=self.board_radius_mm,
            led_radius_mm=self.led_radius_mm,
        )
        check_within("scene", 0, 1, ambient=self.ambient, surroundings=self.surroundings)
        check_within("scene", 1, _MOST_PARTS, soft_shadow_samples=self.soft_shadow_samples)
        self._check_spheres()
        self._check_clutter()
        self._check_camera_place()
        self._check_lights()

    def _check_spheres(self) -> None:
        for i, sphere in enumerate(self.spheres):
            if sphere.centre_mm[2] < sphere.radius_mm - 1e-9:
                raise DataError(f"sphere {i} intersects the board: raise its centre to its radius")
            if self._covers(*sphere.centre_mm[:2], sphere.radius_mm):
                raise DataError(f"sphere {i} overlaps the object: move it outward")
        for (i, a), (j, b) in combinations(enumerate(self.spheres), 2):
            if math.dist(a.centre_mm, b.centre_mm) < a.radius_mm + b.radius_mm:
                raise DataError(f"spheres {i} and {j} overlap: move them apart")

    def _check_clutter(self) -> None:
        for i, item in enumerate(self.clutter):
            reach = item.radius_mm if isinstance(item, Ball) else math.hypot(*item.size_mm[:2]) / 2
            if self._covers(*item.centre_mm[:2], reach):
                raise DataError(f"clutter {i} overlaps the object: move it outward")
            for j, sphere in enumerate(self.spheres):
                if item.gap_mm(sphere.centre_mm) < sphere.radius_mm:
                    raise DataError(f"clutter {i} overlaps sphere {j}: move them apart")
        if self.relief is not None and self.relief.bounds.steepest > _STEEPEST_RELIEF:
            raise DataError(
                f"the relief of the board has slopes of {self.relief.bounds.steepest:.2g}, the "
                f"maximum is {_STEEPEST_RELIEF:g}: make it lower or longer"
            )

    def _covers(self, x: float, y: float, reach_mm: float) -> bool:
        """Return whether the object overlaps a disc on the board, as seen from above."""
        if self.body is None or math.hypot(x, y) >= self.body.radius_mm + reach_mm:
            return False
        reach = reach_mm * np.linspace(0, 1, _RINGS)[:, None]
        turn = np.linspace(0, 2 * math.pi, _SPOKES, endpoint=False)
        return bool(self.body.inside(x + reach * np.cos(turn), y + reach * np.sin(turn)).any())

    def _check_camera_place(self) -> None:
        height = self.lens.camera_z_mm
        if self.body is not None and self.body.top_mm >= height:
            raise DataError(
                f"the camera at {height:g} mm is inside the object, {self.body.top_mm:g} mm high: "
                f"raise the working distance"
            )
        for i, sphere in enumerate(self.spheres):
            if sphere.centre_mm[2] + sphere.radius_mm >= height:
                raise DataError(f"sphere {i} reaches the camera: raise the working distance")
        for i, item in enumerate(self.clutter):
            if item.centre_mm[2] + item.reach_mm >= height:
                raise DataError(f"clutter {i} reaches the camera: raise the working distance")

    def _check_lights(self) -> None:
        if not self.lights.near:
            below = np.asarray(self.lights.directions)[:, 2] <= 0
            if below.any():
                name = self.lights.ids[int(np.argmax(below))]
                raise DataError(f"light {name} is below the surface: turn its direction up")
            return
        positions, axes = np.asarray(self.lights.positions_mm), np.asarray(self.lights.axes)
        floors = self._floors(positions)
        for name, place, axis, floor in zip(self.lights.ids, positions, axes, floors, strict=True):
            if place[2] <= floor:
                raise DataError(f"LED {name} is below the surface: raise its position")
            if place @ axis >= 0:
                raise DataError(f"LED {name} points away from the object: turn its axis")
            for i, sphere in enumerate(self.spheres):
                if math.dist(place, sphere.centre_mm) <= sphere.radius_mm:
                    raise DataError(f"LED {name} is inside sphere {i}: move one of them")
            for i, item in enumerate(self.clutter):
                if item.gap_mm(tuple(place)) <= 0:
                    raise DataError(f"LED {name} is inside clutter {i}: move one of them")

    def _floors(self, positions: Float64) -> Float64:
        """Return the height of the surface under each position."""
        floors = np.zeros(len(positions))
        if self.body is not None:
            above = positions.copy()
            above[:, 2] = self.body.top_mm + 1.0
            hits = self.body.trace(above, np.array([0.0, 0.0, -1.0]))
            floors[hits.hit] = np.maximum(hits.points_mm[hits.hit, 2], 0.0)
        return floors

    @property
    def coloured(self) -> bool:
        """Whether the object's albedo has three channels that differ."""
        return self.pattern.evaluate(np.zeros(1), np.zeros(1)).ndim == 2

    @property
    def sharp(self) -> bool:
        """Whether a pattern has edges and must be averaged over a pixel."""
        return self.pattern.sharp or self.board.sharp

    def albedo(
        self,
        x_mm: Float64,
        y_mm: Float64,
        on_object: Bool,
        item: Int64,
    ) -> Float32:
        """Return the albedo ``(n, 3)`` at points on object and board, 0 beyond the board.

        ``item`` is the index of the clutter that a point is on, -1 for other points.
        """
        on_board = ~on_object & (item < 0) & (x_mm**2 + y_mm**2 <= self.board_radius_mm**2)
        albedo = np.zeros((len(x_mm), 3), np.float32)
        for pattern, where in ((self.pattern, on_object), (self.board, on_board)):
            if where.any():
                values = pattern.evaluate(x_mm[where], y_mm[where])
                albedo[where] = values if values.ndim == 2 else values[:, None]
        for index, thing in enumerate(self.clutter):
            albedo[item == index] = thing.albedo
        return albedo

    @property
    def camera(self) -> CameraModel | None:
        """Camera of the lens; None for an orthographic lens."""
        return self.lens.camera

    @property
    def irradiance(self) -> Float64:
        """``(N,)`` irradiance of each light at the origin, the mean over colours."""
        return np.asarray(np.asarray(self.lights.intensities).mean(axis=1))

    @property
    def axial_intensity(self) -> Float64:
        """``(N,)`` radiant intensity of each LED along its axis, irradiance times mm^2."""
        positions = np.asarray(self.lights.positions_mm)
        axes, mu = np.asarray(self.lights.axes), np.asarray(self.lights.mu)
        squared = (positions**2).sum(axis=1)
        cosine = -(positions * axes).sum(axis=1) / np.sqrt(squared)
        return np.asarray(self.irradiance * squared / cosine**mu)

    @property
    def sphere_table(self) -> Float64:
        """``(S, 5)`` rows of centre, radius and reflectance."""
        rows = [(*s.centre_mm, s.radius_mm, s.reflectance) for s in self.spheres]
        return np.array(rows, np.float64).reshape(-1, 5)

    @property
    def clutter_table(self) -> Float64:
        """``(C, 9)`` kind, centre, radius or half edges, cosine and sine of the turn."""
        return np.array([item.row for item in self.clutter], np.float64).reshape(-1, 9)

    def relief_at(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64]:
        """Return height ``(n,)`` and unit normals ``(n, 3)`` of the board's surface."""
        if self.relief is None:
            flat = np.zeros((len(x_mm), 3))
            flat[:, 2] = 1.0
            return np.zeros(len(x_mm)), flat
        z, zx, zy = self.relief.evaluate(x_mm, y_mm)
        normals = np.stack([-zx, -zy, np.ones_like(z)], axis=1)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return z - self.relief.top_mm, normals
