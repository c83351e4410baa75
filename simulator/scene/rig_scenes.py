"""The simulated bench: lights, camera, sensor, and the scenes that can be recorded on it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from acquisition import CameraModel, DataError, Lights, NoiseModel
from rig.arrays import Float64
from simulator.scene.lens import Lens
from simulator.scene.scene import ChromeSphere, Scene
from simulator.shapes.body import Body
from simulator.shapes.carved_surfaces import (
    CrackedLeather,
    LizardScales,
    StepGauge,
    Textile,
    WoodCarving,
)
from simulator.shapes.coin import Coin
from simulator.shapes.patterns import ChArUco, Checker, Even, Paint, Pattern
from simulator.shapes.surface import BandNoise, Plane, Ripples, SphericalCap

# Elevations of the LED rings. The lowest is high enough to keep cast shadows of the relief small;
# the highest is outside the camera's view.
_RINGS_DEG = (32.0, 46.0, 60.0, 74.0)
_WORKING_DISTANCE_MM = 600.0
_FOCAL_PER_WIDTH = 5000.0 / 2448.0

_RADIUS_MM = 80.0
_WHOLE_FIELD_MM = 250.0

# Names and descriptions. The first scene is the default of a rig.
SCENES: dict[str, str] = {
    "coin": "a domed plaque with sun, sea and letters on velvet",
    "spheres": "four chrome spheres on a grey card, for light calibration",
    "coin-with-spheres": "the plaque and a small chrome sphere in each corner",
    "plane": "a flat disc, painted as a checkerboard",
    "tilted-plane": "a flat disc, tilted",
    "sphere": "a hemisphere, vertical at its rim",
    "ripples": "circular waves",
    "scales": "overlapping scales, like a lizard's skin",
    "textile": "a woven cloth",
    "woodcarving": "a rosette carved into grained wood",
    "leather": "cracked leather",
    "noise": "random waves in a narrow band of wavelengths",
    "step-gauge": "a staircase of known heights",
    "white-plane": "a uniform white plane over the whole field, to measure the lights",
    "charuco": "a ChArUco board, for camera calibration",
}

# Function that makes the object from the scale of its relief in mm and the seed; default scale.
_RELIEFS: dict[str, tuple[Callable[[float, int], Body], float]] = {
    "coin": (lambda mm, seed: Coin(_RADIUS_MM, relief_mm=mm, seed=seed), 0.5),
    "tilted-plane": (lambda mm, _: _tilted(mm), 24.0),
    "sphere": (lambda mm, _: SphericalCap(60.0, mm), 60.0),
    "ripples": (lambda mm, _: Ripples(_RADIUS_MM, mm, 10.0), 0.4),
    "scales": (lambda mm, seed: LizardScales(_RADIUS_MM, mm, seed), 1.6),
    "textile": (lambda mm, seed: Textile(_RADIUS_MM, mm, seed), 1.0),
    "woodcarving": (lambda mm, seed: WoodCarving(_RADIUS_MM, mm, seed), 2.0),
    "leather": (lambda mm, seed: CrackedLeather(_RADIUS_MM, mm, seed), 1.2),
    "noise": (lambda mm, seed: BandNoise(_RADIUS_MM, mm, 8.0, 2.0, seed), 0.15),
    "step-gauge": (
        lambda mm, _: StepGauge(_RADIUS_MM, tuple(mm / part for part in (16, 8, 4, 2, 1))),
        8.0,
    ),
}
_RELIEFS["coin-with-spheres"] = _RELIEFS["coin"]


def dome_lights(
    n: int = 36,
    radius_mm: float = 450.0,
    *,
    seed: int = 0,
    spread: float = 0.03,
    jitter_mm: float = 4.0,
) -> Lights:
    """Place LEDs on rings of a dome around the origin, with the tolerances of a workshop.

    Parameters
    ----------
    n
        Number of LEDs, at least 1; each ring has a share in proportion to its length.
    radius_mm
        Radius of the dome.
    seed
        Seed of positions, intensities and radiation patterns.
    spread
        Relative standard deviation of the intensities; their mean is about 1.
    jitter_mm
        Standard deviation of each coordinate from its nominal value.

    Returns
    -------
    Lights
        Near lights that point at the origin, with ``mu`` within a few percent of 1.

    Raises
    ------
    DataError
        If a value is out of range.

    Examples
    --------
    >>> from simulator import dome_lights
    >>> dome_lights(8)
    Lights(8 positions in mm, L00 to L07)
    """
    if n < 1 or not radius_mm > 0 or not 0 <= spread < 0.3 or not 0 <= jitter_mm < radius_mm / 20:
        raise DataError(
            f"a dome of {n} LEDs, radius {radius_mm} mm, spread {spread}, jitter {jitter_mm} mm "
            f"cannot be built: n >= 1, radius > 0, spread < 0.3, jitter < radius / 20"
        )
    rng = np.random.default_rng(seed)
    elevation = np.radians(_RINGS_DEG)
    ends = np.round(n * np.cumsum(np.cos(elevation)) / np.cos(elevation).sum()).astype(int)
    directions = []
    for ring, count in enumerate(np.diff(ends, prepend=0)):
        azimuth = 2 * math.pi * (np.arange(count) + 0.5 * (ring % 2)) / max(count, 1)
        directions.append(ring_directions(azimuth, elevation[ring]))
    positions = radius_mm * np.concatenate(directions) + rng.normal(0, jitter_mm, (n, 3))
    intensities = np.clip(rng.normal(1, spread, n), 1 - 3 * spread, 1 + 3 * spread)
    mu = np.clip(rng.normal(1, 0.03, n), 0.9, 1.1)
    return Lights(positions_mm=positions, intensities=intensities, mu=mu)


def ring_directions(azimuth: Float64, elevation: float) -> Float64:
    """Return ``(n, 3)`` unit vectors of one elevation; angles are in radians."""
    rise = np.full(len(azimuth), elevation)
    return np.stack(
        [np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)], axis=1
    )


def bench_camera(width: int = 640, height: int = 512) -> CameraModel:
    """Return a camera 600 mm above the board with a field 293 mm wide.

    Raises
    ------
    DataError
        If the size is not positive.

    Examples
    --------
    >>> from simulator import bench_camera
    >>> bench_camera(320, 256)
    CameraModel(320 x 256 px, focal length 653.6 px, working distance 600 mm)
    """
    focal = _FOCAL_PER_WIDTH * max(width, 1)
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return CameraModel(K, width, height, _WORKING_DISTANCE_MM)


def bench_sensor() -> NoiseModel:
    """Return a 12-bit sensor with a full well of 10 000 electrons, as in industrial cameras.

    Examples
    --------
    >>> from simulator import bench_sensor
    >>> sensor = bench_sensor()
    >>> sensor.bit_depth, sensor.full_well_e
    (12, None)
    """
    return NoiseModel(electrons_per_dn=2.5, read_noise_e=2.5, black_level_dn=64.0, bit_depth=12)


def scene_named(
    name: str,
    *,
    width: int = 640,
    height: int = 512,
    leds: int = 36,
    seed: int = 0,
    amplitude_mm: float | None = None,
    sharp: bool = False,
) -> Scene:
    """Build one of the scenes.

    An exposure time of 20 ms suits matte objects. The reflections of the LEDs in chrome spheres
    require about 40 us (``spheres``) or 90 us (``coin-with-spheres``) at a width of 640 pixels;
    this time is inversely proportional to the square of the width.

    Parameters
    ----------
    name
        One of `SCENES`.
    width, height
        Image size in pixels; the field stays 293 mm wide.
    leds
        Number of LEDs on the dome.
    seed
        Seed of lights, texture and paint. The same seed gives the same dome in every scene.
    amplitude_mm
        Scale of the relief: the height parameter of the surface (``relief_mm``, ``rms_mm``,
        ``amplitude_mm``), the rise of the tilted plane, or the height of the highest step.
    sharp
        Whether the lens is perfectly sharp, to compare images with closed forms. By default it has
        the point-spread function of a real one.

    Returns
    -------
    Scene
        Scene that is ready to render.

    Raises
    ------
    DataError
        If the name is unknown, a value is out of range, or there is no relief to scale.

    Examples
    --------
    >>> from simulator import scene_named
    >>> scene_named("coin", width=64, height=52, leds=4)
    Scene(Coin, 4 lights, 0 spheres, 64 x 52 px)
    """
    if name not in SCENES:
        raise DataError(f"unknown scene {name!r}: use one of {', '.join(SCENES)}")
    if amplitude_mm is not None and name not in _RELIEFS:
        raise DataError(f"scene {name} has no relief: do not give an amplitude")
    if amplitude_mm is not None and not (math.isfinite(amplitude_mm) and amplitude_mm > 0):
        raise DataError(f"scene {name}: amplitude is {amplitude_mm} mm, it must be positive")
    body: Body | None = None
    pattern: Pattern = Paint(0.35, 0.75, wavelength_mm=70.0, seed=seed)
    board = Even(0.02)
    spheres: tuple[ChromeSphere, ...] = ()
    if name in _RELIEFS:
        make, usual_mm = _RELIEFS[name]
        body = make(usual_mm if amplitude_mm is None else amplitude_mm, seed)
    elif name == "plane":
        body, pattern = Plane(_RADIUS_MM, 2.0), Checker(0.3, 0.7)
    elif name == "white-plane":
        body, pattern = Plane(_WHOLE_FIELD_MM), Even(0.85)
    elif name == "charuco":
        body, pattern = Plane(_WHOLE_FIELD_MM), ChArUco(10, 8, 26.0)
    if name == "spheres":
        board, spheres = Even(0.4), _CALIBRATION_SPHERES
    elif name == "coin-with-spheres":
        spheres = tuple(_resting(x, y, 12.0) for x in (-112.0, 112.0) for y in (-86.0, 86.0))
    return Scene(
        body=body,
        lights=dome_lights(leds, seed=seed),
        lens=Lens(bench_camera(width, height), sharp=sharp),
        noise=bench_sensor(),
        electrons_per_us=0.42,
        pattern=pattern,
        board=board,
        spheres=spheres,
    )


def _tilted(rise_mm: float) -> Plane:
    """Return a disc that rises by ``rise_mm`` from its lowest to its highest point."""
    slope = rise_mm / (2 * _RADIUS_MM)
    return Plane(_RADIUS_MM, 0.5 + rise_mm / 2, 0.8 * slope, 0.6 * slope)


def _resting(x_mm: float, y_mm: float, radius_mm: float) -> ChromeSphere:
    return ChromeSphere((x_mm, y_mm, radius_mm), radius_mm)


_CALIBRATION_SPHERES = (
    _resting(-92.0, 58.0, 20.0),
    _resting(84.0, 66.0, 16.0),
    _resting(-70.0, -62.0, 14.0),
    _resting(96.0, -54.0, 20.0),
)
