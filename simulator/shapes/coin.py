"""The coin: a round plaque with a dome, a sun over the sea, and raised letters along the rim.

The coin has no symmetry, so a flipped or transposed result is obvious. It is smooth everywhere, so
heights and normals are exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numba
import numpy as np

from rig.arrays import Float64
from rig.kernels import PART
from simulator.shapes.field_trace import FieldBounds
from simulator.shapes.surface import SphericalCap, Surface, drawn, random_waves

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

_DESIGN_RADIUS = 80.0  # all lengths below are for a coin of this radius
_TEXT = "FIAT LVX"
_LETTER_FOOT, _LETTER_HEIGHT, _LETTER_GAP = 51.0, 15.0, 8.0
_LETTER_START_DEG = 160.0
_GRAIN_MM, _GRAIN_WAVES = 4.0, 12
_REACH = 88.0  # beyond it the relief is below 1e-12 mm

# Straight strokes (x0, y0, x1, y1) in units of the letter height, and the letter's width.
_GLYPHS: dict[str, tuple[float, tuple[tuple[float, float, float, float], ...]]] = {
    "F": (0.55, ((0, 0, 0, 1), (0, 1, 0.55, 1), (0, 0.52, 0.42, 0.52))),
    "I": (0.0, ((0, 0, 0, 1),)),
    "A": (0.7, ((0, 0, 0.35, 1), (0.35, 1, 0.7, 0), (0.14, 0.4, 0.56, 0.4))),
    "T": (0.7, ((0.35, 0, 0.35, 1), (0, 1, 0.7, 1))),
    "L": (0.5, ((0, 0, 0, 1), (0, 0, 0.5, 0))),
    "V": (0.7, ((0, 1, 0.35, 0), (0.35, 0, 0.7, 1))),
    "X": (0.65, ((0, 0, 0.65, 1), (0, 1, 0.65, 0))),
    " ": (0.4, ()),
}


@dataclass(frozen=True)
class Coin(Surface):
    """A domed plaque with fine relief, the demonstration object.

    Parameters
    ----------
    dome_mm
        Height of the spherical dome under the relief.
    relief_mm
        Height of the letters; rim, sun, sea and beads are in proportion.
    grain_mm
        Rms of the hammered texture, random waves 4 mm long on a coin of 80 mm radius.
    seed
        Seed of the texture.
    """

    dome_mm: float = 9.0
    relief_mm: float = 0.5
    grain_mm: float = 0.015
    seed: int = 0
    _lengths = ("dome_mm", "relief_mm", "grain_mm")

    @cached_property
    def bounds(self) -> FieldBounds:
        """Lowest and highest height, and the steepest slope."""
        return _bounds(self)

    @cached_property
    def _dome(self) -> SphericalCap:
        return SphericalCap(self.radius_mm, self.dome_mm)

    @cached_property
    def _strokes(self) -> Float64:
        return np.concatenate([_letters(), _sun_rays()])

    @cached_property
    def _grain(self) -> Float64:
        return random_waves(_GRAIN_MM, self.seed, _GRAIN_WAVES)

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64, Float64]:
        """Return height and gradient at positions, see `Surface`."""
        z, zx, zy = self._dome.evaluate(x_mm, y_mm)
        scale = self.radius_mm / _DESIGN_RADIUS
        figure = self._strokes, self._grain, self.relief_mm, self.grain_mm
        height, slope_x, slope_y = drawn(_relief, x_mm, y_mm, *figure, unit_mm=scale)
        return z + height, zx + slope_x / scale, zy + slope_y / scale


# The samples take longer than the rest of a scene, and a rig that is opened again has this coin.
@lru_cache(maxsize=8)
def _bounds(coin: Coin) -> FieldBounds:
    return super(Coin, coin).bounds


def _letters() -> Float64:
    strokes = []
    middle = _LETTER_FOOT + _LETTER_HEIGHT / 2
    angle = math.radians(_LETTER_START_DEG)
    for letter in _TEXT:
        width, lines = _GLYPHS[letter]
        half = width * _LETTER_HEIGHT / 2
        angle -= half / middle  # clockwise text with the feet of the letters toward the centre
        right = np.array([math.sin(angle), -math.cos(angle)])
        up = np.array([math.cos(angle), math.sin(angle)])
        for line in lines:
            ends = np.array(line).reshape(2, 2) * _LETTER_HEIGHT
            across, along = ends[:, 0] - half, ends[:, 1] + _LETTER_FOOT
            strokes.append((across[:, None] * right + along[:, None] * up).ravel())
        angle -= (half + _LETTER_GAP) / middle
    return np.array(strokes)


def _sun_rays() -> Float64:
    rays = []
    for i, angle_deg in enumerate(range(0, 181, 18)):
        direction = np.array([math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))])
        length = 38.0 if i % 2 else 30.0
        rays.append(np.concatenate([19.0 * direction, length * direction]))
    return np.array(rays)


@numba.njit(**PART)
def _step(t: float) -> tuple[float, float]:
    """Return the logistic step and its derivative, without overflow."""
    if t < -40.0:
        return 0.0, 0.0
    if t > 40.0:
        return 1.0, 0.0
    s = 1.0 / (1.0 + math.exp(-t))
    return s, s * (1.0 - s)


@numba.njit(**PART)
def _stroke_union(x: float, y: float, strokes: Float64) -> tuple[float, float, float]:
    """Return the smooth union of ridges with a Gaussian profile, 0 to 1, and its gradient."""
    sigma2 = 1.15**2
    u = ux = uy = 0.0
    for i in range(len(strokes)):
        ax, ay = strokes[i, 0], strokes[i, 1]
        bx, by = strokes[i, 2] - ax, strokes[i, 3] - ay
        t = min(max(((x - ax) * bx + (y - ay) * by) / (bx * bx + by * by), 0.0), 1.0)
        px, py = x - ax - t * bx, y - ay - t * by
        far = (px * px + py * py) / (2.0 * sigma2)
        if far < 36.0:
            e = math.exp(-far)
            ex, ey = -e * px / sigma2, -e * py / sigma2
            ux = ux * (1.0 - e) + (1.0 - u) * ex
            uy = uy * (1.0 - e) + (1.0 - u) * ey
            u += e - u * e
    return u, ux, uy


@numba.njit(**PART)
def _sea(x: float, y: float) -> tuple[float, float, float]:
    """Return curved waves below the sun, with a window, and their gradient."""
    k, bend = 2.0 * math.pi / 8.0, 2.0 * math.pi / 30.0
    angle = k * (y + 0.12 * x + 1.6 * math.sin(bend * x))
    angle_x = k * (0.12 + 1.6 * bend * math.cos(bend * x))
    low, low_t = _step((-10.0 - y) / 1.5)
    round_t = (62.0**2 - x * x - y * y) / (2.0 * 62.0 * 1.2)
    disc, disc_t = _step(round_t)
    disc_x, disc_y = -disc_t * x / (62.0 * 1.2), -disc_t * y / (62.0 * 1.2)
    c, s = 0.5 + 0.5 * math.cos(angle), -0.5 * math.sin(angle)
    window, wx, wy = low * disc, low * disc_x, low * disc_y - low_t / 1.5 * disc
    return c * window, s * angle_x * window + c * wx, s * k * window + c * wy


@numba.njit(**PART)
def _rings(x: float, y: float) -> tuple[float, float, float]:
    """Return the height of rim, ring of beads and sun disc, and its gradient."""
    sun, sun_t = _step((13.0**2 - x * x - y * y) / (2.0 * 13.0 * 0.9))
    sun_g = -sun_t / (13.0 * 0.9)
    h, hx, hy = 1.2 * sun, 1.2 * sun_g * x, 1.2 * sun_g * y
    r = math.hypot(x, y)
    if r > 40.0:
        rim = 1.5 * math.exp(-((r - 75.8) ** 2) / (2.0 * 1.6**2))
        rim_r = -rim * (r - 75.8) / 1.6**2
        ring = 0.3 * math.exp(-((r - 70.4) ** 2) / (2.0 * 1.3**2))
        ring_r = -ring * (r - 70.4) / 1.3**2
        beads = 60.0 * math.atan2(y, x)
        wave, wave_a = 1.0 + math.cos(beads), -60.0 * math.sin(beads)
        radial = (rim_r + ring_r * wave) / r
        around = ring * wave_a / (r * r)
        h += rim + ring * wave
        hx += radial * x - around * y
        hy += radial * y + around * x
    return h, hx, hy


@numba.njit(**PART)
def _hammered(x: float, y: float, grain: Float64) -> tuple[float, float, float]:
    """Return random waves of rms 1 that fade out before the rim, and their gradient."""
    gain = math.sqrt(2.0 / len(grain))
    z = zx = zy = 0.0
    for j in range(len(grain)):
        angle = grain[j, 0] * x + grain[j, 1] * y + grain[j, 2]
        slope = -gain * math.sin(angle)
        z += gain * math.cos(angle)
        zx += grain[j, 0] * slope
        zy += grain[j, 1] * slope
    disc, disc_t = _step((72.0**2 - x * x - y * y) / (2.0 * 72.0 * 0.8))
    fade = disc_t / (72.0 * 0.8)
    return z * disc, zx * disc - z * fade * x, zy * disc - z * fade * y


@numba.njit(nogil=True, cache=True)
def _relief(
    first: int,
    last: int,
    x: Float64,
    y: Float64,
    strokes: Float64,
    grain: Float64,
    relief: float,
    rms: float,
    out: Float64,
) -> None:
    """Write height and gradient of everything above the dome into ``out`` (3, n)."""
    for i in range(first, last):
        if x[i] * x[i] + y[i] * y[i] > _REACH**2:
            continue
        u, ux, uy = _stroke_union(x[i], y[i], strokes)
        w, wx, wy = _sea(x[i], y[i])
        r, rx, ry = _rings(x[i], y[i])
        g, gx, gy = _hammered(x[i], y[i], grain)
        out[0, i] = relief * (u + 0.9 * w + r) + rms * g
        out[1, i] = relief * (ux + 0.9 * wx + rx) + rms * gx
        out[2, i] = relief * (uy + 0.9 * wy + ry) + rms * gy
