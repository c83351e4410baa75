"""Heights and gradients of the carved surfaces, point by point.

All kernels use the units of their design: one unit is the width of a scale, a yarn or a cell, or,
for the wood, a millimetre on a disc of 80 mm radius. Heights are from about 0 to about 1. Where
shapes meet, they are blended by ``log(sum(exp(k h))) / k``, a smooth maximum, so every gradient is
exact. ``table`` has random numbers in -1..1 for each lattice cell and is repeated periodically.

All kernels are in one file because numba's cache does not notice changes of a kernel in another
file.
"""

from __future__ import annotations

import math

import numba

from rig.arrays import Float64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

Point = tuple[float, float, float]

CELLS = 64  # along each side of the table
_MASK = CELLS - 1  # for the index modulo CELLS, also below 0


@numba.njit(**PART)
def _scale_at(u: float, v: float, table: Float64) -> Point:
    """Return keeled rhombic scales in staggered rows; each row overlaps the next one below."""
    sharp = 30.0
    total = tu = tv = 0.0
    row = math.floor(v / 0.62)
    for j in range(row - 1, row + 2):
        shift = 0.5 * (j % 2)
        column = math.floor(u - shift)
        for i in range(column, column + 2):
            random = table[j & _MASK, i & _MASK]
            p = u - (i + shift + 0.05 * random[0])
            q = v - (0.62 * (j + 0.5) + 0.04 * random[1])
            # (|a| + |b|)^2 with rounded creases; it is 1 where neighbours meet.
            a, b = p / 0.5, q / 0.62
            cross = math.sqrt(a * a * b * b + 0.0025)
            rho = a * a + b * b + 2.0 * cross - 0.1
            rho_p = (2.0 * a + 2.0 * a * b * b / cross) / 0.5
            rho_q = (2.0 * b + 2.0 * a * a * b / cross) / 0.62
            keel = 0.2 * math.exp(-(p * p) / (2.0 * 0.06**2) - q * q / (2.0 * 0.25**2))
            h = 0.6 + 0.06 * random[2] - 0.7 * q - 0.5 * rho * rho + keel
            e = math.exp(sharp * h)
            total += e
            tu += e * (-rho * rho_p - keel * p / 0.06**2)
            tv += e * (-0.7 - rho * rho_q - keel * q / 0.25**2)
    return math.log(total) / sharp, tu / total, tv / total


@numba.njit(**PART)
def _yarn(across: float, along: float, first: int, side: float, table: Float64, lane: int) -> Point:
    """Return sums of exp(k h) and of its derivatives over the yarns near a point."""
    sharp = 16.0
    total = ta = tl = 0.0
    for i in range(first - 1, first + 3):
        random = table[i & _MASK, lane]
        width = 1.0 + 0.12 * random[0]
        p = across - i - 0.05 * random[1]
        sign = side if i % 2 else -side
        wave, wave_l = sign * math.cos(math.pi * along), -sign * math.pi * math.sin(math.pi * along)
        # Twisted fibres are oblique to the yarn.
        turn = 2.0 * math.pi * (3.0 * along + 2.2 * p + random[2])
        round_ = 2.1 / width**2
        h = 0.5 + 0.24 * wave - round_ * p * p + 0.022 * math.cos(turn)
        e = math.exp(sharp * h)
        total += e
        ta += e * (-2.0 * round_ * p - 0.022 * 2.0 * math.pi * 2.2 * math.sin(turn))
        tl += e * (0.24 * wave_l - 0.022 * 2.0 * math.pi * 3.0 * math.sin(turn))
    return total, ta, tl


@numba.njit(**PART)
def _textile_at(u: float, v: float, table: Float64) -> Point:
    """Return a plain weave: warp along v, weft along u, alternating over and under."""
    warp, warp_u, warp_v = _yarn(u, v, math.floor(u), 1.0, table, 0)
    weft, weft_v, weft_u = _yarn(v, u, math.floor(v), -1.0, table, 1)
    total = warp + weft
    return math.log(total) / 16.0, (warp_u + weft_u) / total, (warp_v + weft_v) / total


@numba.njit(**PART)
def _cells(u: float, v: float, sharp: float, table: Float64) -> tuple[Point, Point]:
    """Return two smooth functions of the random cells around a point, with gradients.

    The first is the squared distance to the centre of the nearest cell. The second is the degree to
    which the point belongs to several cells at once: 0 within a cell, about 1/2 midway between two.
    The weights of cells in it differ, so that some borders are deep and others almost vanish.
    """
    column, row = math.floor(u), math.floor(v)
    nearest = math.inf
    for j in range(row - 2, row + 3):
        for i in range(column - 2, column + 3):
            random = table[j & _MASK, i & _MASK]
            p, q = u - (i + 0.5 + 0.42 * random[0]), v - (j + 0.5 + 0.42 * random[1])
            nearest = min(nearest, p * p + q * q)
    total = own = own2 = 0.0
    tu = tv = su = sv = qu = qv = 0.0
    for j in range(row - 2, row + 3):
        for i in range(column - 2, column + 3):
            random = table[j & _MASK, i & _MASK]
            p, q = u - (i + 0.5 + 0.42 * random[0]), v - (j + 0.5 + 0.42 * random[1])
            behind = sharp * (p * p + q * q - nearest)
            # The omitted terms are below rounding error.
            if behind > 40.0:
                continue
            # nearest cancels out in every result, so it is treated as a constant here.
            e = math.exp(-behind)
            eu, ev = -2.0 * sharp * p * e, -2.0 * sharp * q * e
            share = 0.6 + 0.4 * random[2]
            total += e
            tu += eu
            tv += ev
            own += share * e
            su += share * eu
            sv += share * ev
            own2 += (share * e) ** 2
            qu += 2.0 * share * share * e * eu
            qv += 2.0 * share * share * e * ev
    near = nearest - math.log(total) / sharp, -tu / (total * sharp), -tv / (total * sharp)
    several = (own * own - own2) / (total * total)
    several_u = (2.0 * own * su - qu) / (total * total) - 2.0 * several * tu / total
    several_v = (2.0 * own * sv - qv) / (total * total) - 2.0 * several * tv / total
    return near, (several, several_u, several_v)


@numba.njit(**PART)
def _leather_at(u: float, v: float, table: Float64) -> Point:
    """Return fine pebbles with a network of cracks; one unit is the width of a plate."""
    # Distorted positions bend the cracks and move the centres of the plates.
    a, b = 2.9 * v + 0.8, 3.7 * u + 2.1
    c, d = 7.3 * v + 1.7 * u, 6.1 * u - 2.3 * v
    x = u + 0.07 * math.sin(a) + 0.025 * math.sin(c)
    y = v + 0.07 * math.sin(b) + 0.025 * math.sin(d)
    x_u, x_v = 1.0 + 0.025 * 1.7 * math.cos(c), 0.07 * 2.9 * math.cos(a) + 0.025 * 7.3 * math.cos(c)
    y_u = 0.07 * 3.7 * math.cos(b) + 0.025 * 6.1 * math.cos(d)
    y_v = 1.0 - 0.025 * 2.3 * math.cos(d)
    plate, crack = _cells(x, y, 34.0, table)
    fine = 5.5
    pebble, _ = _cells(fine * u + 31.0, fine * v + 17.0, 12.0, table)
    # tanh limits the depth where many cracks meet.
    depth = math.tanh(1.8 * crack[0])
    steep = -0.9 * 1.8 * (1.0 - depth * depth)
    h = 0.86 - 0.9 * depth - 0.22 * plate[0] - 0.24 * pebble[0]
    hx = steep * crack[1] - 0.22 * plate[1]
    hy = steep * crack[2] - 0.22 * plate[2]
    return (
        h,
        hx * x_u + hy * y_u - 0.24 * fine * pebble[1],
        hx * x_v + hy * y_v - 0.24 * fine * pebble[2],
    )


@numba.njit(**PART)
def _soft_positive(t: float, k: float) -> tuple[float, float]:
    """Return a smooth max(t, 0) and its derivative."""
    if k * t > 40.0:
        return t, 1.0
    if k * t < -40.0:
        return 0.0, 0.0
    e = math.exp(k * t)
    return math.log1p(e) / k, e / (1.0 + e)


@numba.njit(**PART)
def _chips(x: float, y: float, lenses: Float64) -> Point:
    """Return the depth (mm) of cuts in the shape of two overlapping discs, and its gradient."""
    depth = dx = dy = 0.0
    for i in range(len(lenses)):
        radius = lenses[i, 4]
        ax, ay = x - lenses[i, 0], y - lenses[i, 1]
        bx, by = x - lenses[i, 2], y - lenses[i, 3]
        far_a, far_b = math.sqrt(ax * ax + ay * ay + 1e-6), math.sqrt(bx * bx + by * by + 1e-6)
        a, b = radius - far_a, radius - far_b
        if min(a, b) < -4.0:
            continue
        # A smooth minimum of both: a V with a rounded bottom.
        half, gap = 0.5 * (a + b), 0.5 * (a - b)
        bend = math.sqrt(gap * gap + 0.04)
        cut, cut_t = _soft_positive(half - bend, 12.0)
        wa, wb = 0.5 - 0.5 * gap / bend, 0.5 + 0.5 * gap / bend
        depth += cut
        dx -= cut_t * (wa * ax / far_a + wb * bx / far_b)
        dy -= cut_t * (wa * ay / far_a + wb * by / far_b)
    return depth, dx, dy


@numba.njit(**PART)
def _wood_at(x: float, y: float, lenses: Float64, waves: Float64) -> Point:
    """Return a chip-carved rosette between two round grooves, in wood with grain."""
    cut, cut_x, cut_y = _chips(x, y, lenses)
    h, hx, hy = 0.95 - cut / 6.0, -cut_x / 6.0, -cut_y / 6.0
    r = math.sqrt(x * x + y * y + 1e-6)
    for ring, width, depth in ((50.0, 1.3, 0.5), (73.0, 1.8, 0.65)):
        groove = depth * math.exp(-((r - ring) ** 2) / (2.0 * width**2))
        slope = groove * (r - ring) / width**2
        h -= groove
        hx += slope * x / r
        hy += slope * y / r
    # Year rings around a pith far outside, distorted by long waves; late wood has the ridges.
    px, py = x + 60.0, y + 330.0
    far = math.hypot(px, py)
    year, year_x, year_y = far, px / far, py / far
    for j in range(len(waves)):
        angle = waves[j, 0] * x + waves[j, 1] * y + waves[j, 2]
        year += 1.6 * math.cos(angle)
        year_x -= 1.6 * waves[j, 0] * math.sin(angle)
        year_y -= 1.6 * waves[j, 1] * math.sin(angle)
    k = 2.0 * math.pi / 4.3
    s, c = math.sin(k * year), math.cos(k * year)
    grain = 0.045 * math.exp(2.0 * (c - 1.0))
    slope = -2.0 * k * s * grain
    return h + grain, hx + slope * year_x, hy + slope * year_y


@numba.njit(nogil=True, cache=True)
def scales(first: int, last: int, x: Float64, y: Float64, table: Float64, out: Float64) -> None:
    """Write height and gradient of lizard scales into ``out`` (3, n)."""
    for i in range(first, last):
        out[0, i], out[1, i], out[2, i] = _scale_at(x[i], y[i], table)


@numba.njit(nogil=True, cache=True)
def textile(first: int, last: int, x: Float64, y: Float64, table: Float64, out: Float64) -> None:
    """Write height and gradient of a plain weave into ``out`` (3, n)."""
    for i in range(first, last):
        out[0, i], out[1, i], out[2, i] = _textile_at(x[i], y[i], table)


@numba.njit(nogil=True, cache=True)
def leather(first: int, last: int, x: Float64, y: Float64, table: Float64, out: Float64) -> None:
    """Write height and gradient of cracked leather into ``out`` (3, n)."""
    for i in range(first, last):
        out[0, i], out[1, i], out[2, i] = _leather_at(x[i], y[i], table)


@numba.njit(nogil=True, cache=True)
def wood(
    first: int, last: int, x: Float64, y: Float64, lenses: Float64, waves: Float64, out: Float64
) -> None:
    """Write height and gradient of a wood carving into ``out`` (3, n)."""
    for i in range(first, last):
        out[0, i], out[1, i], out[2, i] = _wood_at(x[i], y[i], lenses, waves)
