"""Simulated objects that are recorded twice: moved and turned in between, and perhaps changed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from imperfections.recordings import BRIGHTEST, Recording, mask_file
from scipy.ndimage import map_coordinates

from acquisition import CameraModel, LightErrors, Lights, read_source
from processing import Reconstruction, reconstruct
from rig.arrays import Bool, Float32, Float64
from simulator import Lens, Scene, bench_sensor, dome_lights, render
from simulator.camera import sensor_image
from simulator.scene.lens import Optics
from simulator.shapes import BandNoise, Coin, CrackedLeather, Textile, WoodCarving
from simulator.shapes.grounds import Cork, Print, Weave, Wood
from simulator.shapes.patterns import Paint, Pattern
from simulator.shapes.surface import Surface

PIXEL_MM = 0.05
SIZE = 420
DISTANCE_MM = 600.0
# Deviation of the lights from what is stated, relative.
LIGHT_ERROR = 0.02
_DESIGN_MM = 80.0
_GRID_MM = 0.1


@dataclass(frozen=True)
class Alteration:
    """Material that is lost: a scratch, or a round piece.

    Parameters
    ----------
    x_mm, y_mm
        Its middle on the object.
    width_mm
        Full width at half of the depth; of a piece, its diameter.
    depth_mm
        Depth; the cross-section of a scratch is a Gaussian, a piece has a level floor.
    length_mm
        Length of a scratch; 0 for a piece.
    angle_deg
        Direction of a scratch, counterclockwise from x.
    """

    x_mm: float
    y_mm: float
    width_mm: float
    depth_mm: float
    length_mm: float = 0.0
    angle_deg: float = 0.0

    def evaluate(self, x: Float64, y: Float64) -> tuple[Float64, Float64, Float64]:
        """Return the change of height and of its gradient."""
        turn = math.radians(self.angle_deg)
        cos, sin = math.cos(turn), math.sin(turn)
        u = (x - self.x_mm) * cos + (y - self.y_mm) * sin
        v = (y - self.y_mm) * cos - (x - self.x_mm) * sin
        if self.length_mm:
            sigma = self.width_mm / 2.3548
            across = np.exp(-0.5 * (v / sigma) ** 2)
            slope_v = -v / sigma**2 * across
            along, slope_u = _plateau(u, self.length_mm / 2, self.width_mm / 2)
            h, hu, hv = across * along, across * slope_u, slope_v * along
        else:
            r = np.hypot(u, v)
            h, slope = _plateau(r, self.width_mm / 2, 0.03)
            hu, hv = (slope * w / np.maximum(r, 1e-12) for w in (u, v))
        gain = -self.depth_mm
        return gain * h, gain * (hu * cos - hv * sin), gain * (hu * sin + hv * cos)


def _plateau(t: Float64, half: float, edge: float) -> tuple[Float64, Float64]:
    """Return 1 inside and 0 outside of +-half, with edges of a scale, and its derivative."""
    rise, fall = np.tanh((t + half) / edge), np.tanh((t - half) / edge)
    return (rise - fall) / 2, (fall**2 - rise**2) / (2 * edge)


@dataclass(frozen=True)
class Placed(Surface):
    """A surface in another size, altered, and then moved and turned in space.

    Parameters
    ----------
    parts
        Surfaces whose heights are added.
    alterations
        What is different on the object.
    turn_deg, shift_mm, tilt_deg
        Rotation about Z, shift along X and Y, and rotations about X and Y.
    scale
        Size of the parts.
    """

    parts: tuple[Surface, ...] = ()
    alterations: tuple[Alteration, ...] = ()
    turn_deg: float = 0.0
    shift_mm: tuple[float, float] = (0.0, 0.0)
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0

    @cached_property
    def rotation(self) -> Float64:
        """Rotation of the object in space."""
        turn, a, b = np.radians([self.turn_deg, *self.tilt_deg])
        z = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        return np.asarray(x @ y @ z)

    def _own(self, u: Float64, v: Float64) -> tuple[Float64, Float64, Float64]:
        h, hx, hy = (np.zeros(np.shape(u)) for _ in range(3))
        for part in self.parts:
            z, zx, zy = part.evaluate(u / self.scale, v / self.scale)
            h, hx, hy = h + self.scale * z, hx + zx, hy + zy
        for one in self.alterations:
            near = (u - one.x_mm) ** 2 + (v - one.y_mm) ** 2 < (
                one.length_mm + 4 * one.width_mm + 0.3
            ) ** 2
            z, zx, zy = one.evaluate(u[near], v[near])
            h[near] += z
            hx[near] += zx
            hy[near] += zy
        return h, hx, hy

    def own_place(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64]:
        """Return the position on the object, without its movement, of a place on the board."""
        R = self.rotation
        x, y = np.asarray(x_mm) - self.shift_mm[0], np.asarray(y_mm) - self.shift_mm[1]
        inverse = np.linalg.inv(R[:2, :2])
        h: Float64 = np.zeros(x.shape)
        for _ in range(3 if any(self.tilt_deg) else 1):
            a, b = x - R[0, 2] * h, y - R[1, 2] * h
            u, v = inverse[0, 0] * a + inverse[0, 1] * b, inverse[1, 0] * a + inverse[1, 1] * b
            if any(self.tilt_deg):
                at = [w / _GRID_MM + len(self._grid) // 2 for w in (v, u)]
                h = map_coordinates(self._grid, at, order=1, mode="nearest")
        return u, v

    @cached_property
    def _grid(self) -> Float64:
        """Heights without the movement, good enough for the effect of a tilt on places."""
        half = math.ceil(1.3 * self.radius_mm / _GRID_MM)
        v, u = np.mgrid[-half : half + 1, -half : half + 1] * _GRID_MM
        return self._own(u, v)[0]

    def place_of(self, u_mm: float, v_mm: float) -> tuple[float, float]:
        """Return where a point of the object is on the board."""
        h = float(self._own(np.array([u_mm]), np.array([v_mm]))[0][0])
        x, y = (self.rotation @ [u_mm, v_mm, h])[:2] + self.shift_mm
        # Perspective, relative to the working plane.
        nearer = DISTANCE_MM / (DISTANCE_MM - h)
        return float(x * nearer), float(y * nearer)

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64, Float64]:
        """Return height and gradient at positions."""
        u, v = self.own_place(np.asarray(x_mm, float), np.asarray(y_mm, float))
        h, hx, hy = self._own(u, v)
        R = self.rotation
        n = [-R[k, 0] * hx - R[k, 1] * hy + R[k, 2] for k in range(3)]
        return R[2, 0] * u + R[2, 1] * v + R[2, 2] * h, -n[0] / n[2], -n[1] / n[2]


@dataclass(frozen=True)
class Painted(Pattern):
    """The paint of an object that was moved."""

    sharp = True
    paint: Pattern
    surface: Placed

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions."""
        u, v = self.surface.own_place(x_mm, y_mm)
        return self.paint.evaluate(u, v)


def _fine(seed: int) -> BandNoise:
    return BandNoise(_DESIGN_MM, 0.012, 3.0, 0.5, seed)


def object_named(name: str, seed: int) -> tuple[Placed, Pattern]:
    """Return an object 19 mm across, with relief down to 8 pixels, and its paint."""
    base, paint = {
        "coin": (Coin(_DESIGN_MM, 9, 0.5, 0.02, seed), Paint(0.4, 0.8, 3, seed)),
        "leather": (CrackedLeather(_DESIGN_MM, 1.0, seed), Cork(0.35, 0.6, 0.6, seed)),
        "textile": (Textile(_DESIGN_MM, 0.6, seed, 8), Weave(0.3, 0.6, 0.5)),
        "woodcarving": (WoodCarving(_DESIGN_MM, 1.5, seed), Wood(0.3, 0.6, 0.8, 20, seed)),
        "print": (BandNoise(_DESIGN_MM, 0.1, 16, 1.5, seed), Print(0.8, 0.2, 0.8, 10, seed)),
        "plaster": (BandNoise(_DESIGN_MM, 0.05, 6, 2.0, seed), Cork(0.6, 0.65, 0.6, seed)),
    }[name]
    radius = 9.4
    return Placed(radius, (base, _fine(seed)), scale=radius / _DESIGN_MM), paint


OBJECTS = ("coin", "leather", "textile", "woodcarving", "print")


def moved(surface: Placed, rng: np.random.Generator) -> Placed:
    """Return an object that was taken away and put back: some pixels, degrees, and a tilt."""
    shift, tilt = rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.3, 0.3, 2)
    return replace(
        surface,
        turn_deg=float(rng.uniform(-6, 6)),
        shift_mm=(float(shift[0]), float(shift[1])),
        tilt_deg=(float(tilt[0]), float(tilt[1])),
    )


def recorded(
    surface: Surface,
    paint: Pattern,
    seed: int,
    *,
    lights: int = 36,
    size: int = SIZE,
    error: float = LIGHT_ERROR,
    stated: bool = False,
    blur_px: float = 0.7,
) -> Reconstruction:
    """Record an object, and process it with lights that deviate from the true ones.

    ``error`` is the relative deviation; the lights state it if they are ``stated``. ``blur_px`` is
    the standard deviation of the blur by the aberrations of the lens.
    """
    true = dome_lights(lights, seed=11)
    images, mask = _photographs(surface, paint, true, seed, size, blur_px)
    assumed = deviating(true, np.random.default_rng([seed, 2]), error, stated=stated)
    camera = _camera(size)
    recording = Recording("pair", images, assumed, camera, mask, None, None)
    with TemporaryDirectory() as name:
        folder = Path(name) / "images"
        recording.write(folder)
        source = read_source(folder, lights=assumed, mask_path=mask_file(folder), camera=camera)
        return reconstruct(source, align="off", surface=False)


def _camera(size: int) -> CameraModel:
    """Return a camera whose pixels are `PIXEL_MM` for `SIZE` pixels."""
    focal = DISTANCE_MM / PIXEL_MM * size / SIZE
    middle = (size - 1) / 2
    matrix = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    return CameraModel(matrix, size, size, DISTANCE_MM)


def _photographs(
    surface: Surface, paint: Pattern, lights: Lights, seed: int, size: int, blur_px: float
) -> tuple[Float32, Bool]:
    """Return images with the noise of a sensor; a pixel is the mean of 2 x 2 that are rendered."""
    optics = Optics(focal_length_mm=50.0)
    lens = Lens(_camera(2 * size), sharp=False, psf_sigma_px=2 * blur_px, optics=optics)
    sensor = bench_sensor()
    scene = Scene(surface, lights, lens, sensor, 0.42, Painted(paint, surface))
    made = render(scene)

    def halved(of: Float32) -> Float32:
        return of.reshape(*of.shape[:-2], size, 2, size, 2).mean(axis=(-3, -1), dtype=np.float32)

    planes, ambient = halved(made.planes), halved(made.ambient)
    white = (sensor.converter_end_dn - sensor.black_level_dn) * sensor.electrons_per_dn
    exposure_us = 0.7 * white / float(np.percentile(planes, 99.9))
    dark = sensor.black_level_dn + ambient * exposure_us / sensor.electrons_per_dn
    images = np.stack(
        [
            sensor_image((plane + ambient) * exposure_us, sensor, key=(seed, shot)) - dark
            for shot, plane in enumerate(planes)
        ]
    ).astype(np.float32)
    images *= np.float32(BRIGHTEST / np.percentile(images, 99.9))
    return images, halved(made.truth.mask.astype(np.float32)) == 1


def deviating(
    lights: Lights, rng: np.random.Generator, error: float, *, stated: bool = False
) -> Lights:
    """Return lights whose positions and intensities deviate, and perhaps state by how much."""
    places = np.asarray(lights.positions_mm)
    away = np.linalg.norm(places, axis=1, keepdims=True)
    deviation = error * away / math.sqrt(3)
    places = places + deviation * rng.normal(size=places.shape)
    intensities = np.asarray(lights.intensities) * (1 + error * rng.normal(size=(len(places), 1)))
    errors = LightErrors(
        covariances=deviation[..., None] ** 2 * np.eye(3), intensity_std=error * intensities
    )
    return replace(
        lights, positions_mm=places, intensities=intensities, errors=errors if stated else None
    )


@dataclass(frozen=True)
class Planted:
    """A change in a grid, with what it is."""

    kind: str
    width_px: float
    depth_um: float
    change: Alteration


def altered(surface: Placed, plants: Sequence[Planted]) -> Placed:
    """Return an object with planted changes."""
    return replace(surface, alterations=tuple(one.change for one in plants))


def planted(kinds: Sequence[tuple[str, float, float]], rng: np.random.Generator) -> list[Planted]:
    """Return one change of each kind (kind, width in pixels, depth in um), at random cells."""
    step = 56 * PIXEL_MM
    cells = [
        (x * step, y * step)
        for x in range(-3, 4)
        for y in range(-3, 4)
        if math.hypot(x, y) * step < 7.6
    ]
    chosen = rng.permutation(len(cells))[: len(kinds)]
    made = []
    for (kind, width, depth), cell in zip(kinds, chosen, strict=True):
        x, y = (float(one + rng.uniform(-0.1, 0.1)) for one in cells[cell])
        change = Alteration(
            x,
            y,
            width * PIXEL_MM,
            depth / 1000,
            2.0 if kind == "scratch" else 0.0,
            float(rng.uniform(0, 180)),
        )
        made.append(Planted(kind, width, depth, change))
    return made
