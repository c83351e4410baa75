"""Albedo of everyday grounds: cork, wood, printed paper and cloth, drawn from hashes of a seed.

The albedo of a position depends only on the position and the seed. All grounds have edges; the
renderer averages them over a pixel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np

from rig import in_threads
from rig.arrays import Float64
from rig.kernels import PART
from simulator.shapes.patterns import Pattern, blend, turned
from simulator.shapes.ranges import Albedo

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# A glyph is 3 x 5 modules of a cell of 4 x 9: the rest is the space between letters and lines.
_GLYPH_COLUMNS, _GLYPH_ROWS, _CELL_COLUMNS, _CELL_ROWS = 3, 5, 4, 9


@dataclass(frozen=True)
class Cork(Pattern):
    """Grains of random albedo with dark seams, as in cork and chipboard.

    The grains are the cells of jittered points (Worley, A cellular texture basis function, 1996).

    Parameters
    ----------
    low, high
        Albedo of the darkest and the lightest grain, grey or ``(r, g, b)``.
    grain_mm
        Mean width of a grain.
    seed
        Seed of the pattern.
    """

    sharp = True
    low: Albedo = 0.25
    high: Albedo = 0.55
    grain_mm: float = 3.0
    seed: int = 0

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions, see `Pattern`."""
        share = _drawn(_cork, x_mm / self.grain_mm, y_mm / self.grain_mm, self.seed)
        return blend(self.low, self.high, share)


@dataclass(frozen=True)
class Wood(Pattern):
    """Wood grain: wavering rings along a direction, crossed by fine fibres.

    Parameters
    ----------
    low, high
        Albedos of late and early wood, grey or ``(r, g, b)``.
    ring_mm
        Mean width of a ring.
    angle_deg
        Direction of the grain, counterclockwise from x.
    seed
        Seed of the pattern.
    """

    sharp = True
    low: Albedo = 0.2
    high: Albedo = 0.5
    ring_mm: float = 6.0
    angle_deg: float = 0.0
    seed: int = 0

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions, see `Pattern`."""
        x, y = turned(x_mm, y_mm, self.angle_deg)
        share = _drawn(_wood, x / self.ring_mm, y / self.ring_mm, self.seed)
        return blend(self.low, self.high, share)


@dataclass(frozen=True)
class Print(Pattern):
    """Lines of text-like marks on paper: letters of random strokes, words, and short lines.

    Parameters
    ----------
    paper, ink
        Albedos, grey or ``(r, g, b)``.
    line_mm
        Distance between lines; a letter is 5/9 of it high.
    angle_deg
        Direction of the lines, counterclockwise from x.
    seed
        Seed of the marks.
    """

    sharp = True
    paper: Albedo = 0.8
    ink: Albedo = 0.06
    line_mm: float = 6.0
    angle_deg: float = 0.0
    seed: int = 0

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions, see `Pattern`."""
        module = self.line_mm / _CELL_ROWS
        x, y = turned(x_mm, y_mm, self.angle_deg)
        return blend(self.paper, self.ink, _drawn(_print, x / module, -y / module, self.seed))


@dataclass(frozen=True)
class Weave(Pattern):
    """Albedo of a plain weave: each yarn is lightest where it is on top, and dark in the gaps.

    Parameters
    ----------
    low, high
        Albedo of the gaps, and the largest albedo of a yarn; grey or ``(r, g, b)``.
    yarn_mm
        Distance between yarns.
    angle_deg
        Direction of the weft, counterclockwise from x.
    seed
        Seed of the albedos of the yarns.
    """

    sharp = True
    low: Albedo = 0.1
    high: Albedo = 0.6
    yarn_mm: float = 2.0
    angle_deg: float = 0.0
    seed: int = 0

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions, see `Pattern`."""
        x, y = turned(x_mm, y_mm, self.angle_deg)
        share = _drawn(_weave, x / self.yarn_mm, y / self.yarn_mm, self.seed)
        return blend(self.low, self.high, share)


def _drawn(
    kernel: Callable[[int, int, Float64, Float64, int, Float64], None],
    x: Float64,
    y: Float64,
    seed: int,
) -> Float64:
    """Return the values of a kernel at positions of one shape."""
    out = np.zeros(np.shape(x))
    flat_x, flat_y = (np.ascontiguousarray(v, np.float64).ravel() for v in (x, y))
    in_threads(kernel, out.size, flat_x, flat_y, seed % 2**31, out.reshape(-1))
    return out


@numba.njit(**PART)
def _chance(i: int, j: int, seed: int) -> float:
    """Return a number within 0..1 that depends only on the arguments (a 32-bit integer hash)."""
    mask = np.uint64(0xFFFFFFFF)
    h = (np.uint64(i & 0xFFFFFFFF) * np.uint64(0x9E3779B1)) & mask
    h ^= (np.uint64(j & 0xFFFFFFFF) * np.uint64(0x85EBCA77)) & mask
    h ^= (np.uint64(seed & 0xFFFFFFFF) * np.uint64(0xC2B2AE3D)) & mask
    for _ in range(2):
        h ^= h >> np.uint64(15)
        h = (h * np.uint64(0x2C1B3C6D)) & mask
        h ^= h >> np.uint64(13)
        h = (h * np.uint64(0x297A2D39)) & mask
    h ^= h >> np.uint64(16)
    return float(h) / 4294967296.0


@numba.njit(**PART)
def _smooth(x: float, y: float, seed: int) -> float:
    """Return noise within 0..1 that varies smoothly over a length of 1."""
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    near: float = _chance(i, j, seed) * (1.0 - u) + _chance(i + 1, j, seed) * u
    far: float = _chance(i, j + 1, seed) * (1.0 - u) + _chance(i + 1, j + 1, seed) * u
    return near * (1.0 - v) + far * v


@numba.njit(nogil=True, cache=True)
def _cork(begin: int, end: int, x: Float64, y: Float64, seed: int, out: Float64) -> None:
    for n in range(begin, end):
        column, row = math.floor(x[n]), math.floor(y[n])
        first = second = 9.0
        level = 0.0
        for j in range(row - 1, row + 2):
            for i in range(column - 1, column + 2):
                dx = i + _chance(i, j, seed) - x[n]
                dy = j + _chance(i, j, seed + 1) - y[n]
                gap = math.sqrt(dx * dx + dy * dy)
                if gap < first:
                    first, second = gap, first
                    level = _chance(i, j, seed + 2)
                elif gap < second:
                    second = gap
        # One grain in twelve is bark, nearly as dark as the seams.
        level = 0.1 * level if level < 0.08 else 0.3 + 0.7 * level
        out[n] = level * min(1.0, (second - first) / 0.12)


@numba.njit(nogil=True, cache=True)
def _wood(first: int, last: int, x: Float64, y: Float64, seed: int, out: Float64) -> None:
    for n in range(first, last):
        across = y[n] + 2.0 * _smooth(x[n] / 18.0, y[n] / 3.0, seed)
        across += 0.5 * _smooth(x[n] / 6.0, y[n], seed + 1)
        ring = math.floor(across)
        # Light early wood darkens slowly into late wood, which ends abruptly.
        phase = across - ring
        tone = 1.0 - phase**3 * (0.6 + 0.4 * _chance(ring, 0, seed + 2))
        fibre = _smooth(x[n] / 1.5, y[n] / 0.05, seed + 3)
        out[n] = tone * (0.8 + 0.2 * fibre)


@numba.njit(nogil=True, cache=True)
def _print(first: int, last: int, x: Float64, y: Float64, seed: int, out: Float64) -> None:
    for n in range(first, last):
        column, row = math.floor(x[n]), math.floor(y[n])
        letter, line = math.floor(column / _CELL_COLUMNS), math.floor(row / _CELL_ROWS)
        i, j = column - letter * _CELL_COLUMNS, row - line * _CELL_ROWS
        # Paragraphs: every line of forty letters ends early, some lines are empty.
        block = math.floor(letter / 40)
        end = 40.0 * (0.5 + 0.7 * _chance(block, line, seed + 1))
        blank = _chance(letter, line, seed + 2) < 0.16 or letter - 40 * block > end
        if blank or i >= _GLYPH_COLUMNS or j >= _GLYPH_ROWS:
            continue
        glyph = int(40.0 * _chance(letter, line, seed + 3))
        # Strokes: each glyph has an upright, and modules at random.
        if i == glyph % 3 or _chance(i + 3 * j, glyph, seed + 4) < 0.4:
            out[n] = 1.0


@numba.njit(nogil=True, cache=True)
def _weave(first: int, last: int, x: Float64, y: Float64, seed: int, out: Float64) -> None:
    for n in range(first, last):
        i, j = math.floor(x[n]), math.floor(y[n])
        u, v = 2.0 * (x[n] - i) - 1.0, 2.0 * (y[n] - j) - 1.0
        weft = (i + j) % 2 == 0
        across, along, yarn, side = (v, u, j, 0) if weft else (u, v, i, 1)
        # A yarn covers 0.85 of its pitch and bends down at both ends.
        if abs(across) < 0.85:
            tone = 0.7 + 0.3 * _chance(yarn, side, seed)
            out[n] = tone * math.sqrt(1.0 - across * across) * (1.0 - 0.4 * along * along)
