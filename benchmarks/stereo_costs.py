"""Costs of photometric stereo against their limits, in one table.

CPU time, the least of several rounds, each of which measures every row once: other work on the
machine disturbs all rows alike. Images are reliefs of --lights lights with noise, matte, or with a
highlight that makes all iterations necessary. "copies" is the CPU time in copies of the stack of
float32, "beyond" the growth of the memory beyond the maps that are returned. "linear" compares the
time per pixel between images of several sizes, the largest of which --largest limits.
"sgp normals" is the whole command on a session of these images, with the method cauchy, against the
solver on the stack in memory. Run it twice: the first run may compile kernels.

    NUMBA_NUM_THREADS=1 python benchmarks/stereo_costs.py
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from harness import Cost, command_line, copy_s, measured
from sessions import write_session
from whole_commands import cost as command_cost

from acquisition import Lights, read_source, write_lights, write_mask
from acquisition.plan import PlannedShot
from calibration import linear_stack
from processing import Method, photometric_stereo
from processing.noise import normal_uncertainty
from processing.stereo import METHODS
from rig.arrays import Float32, Float64, UInt16

_NOISE = 0.01
# Shorter work is measured more often.
_SHORT_S, _AGAIN = 1.0, 5
_LIMITS = {"ls": 3.0, "near ls": 0.3, "cauchy": 2.0, "best": 8.0}
_LIMITS_96 = {"best": 10.0}
_ROWS = 128
# Megapixels, and from which size on one round is enough.
_SIZES = (0.3, 1.0, 5.0, 20.0)
_LARGE = 10.0
_TABLES = ("kernels", "kernels-96", "command", "linear")
_BLACK, _PER_SIGNAL = 100, 3500
# Bytes of the maps of one pixel: normal, albedo, residual and number of samples.
_OF_MAPS = 4 * 3 + 4 + 4 + 2


@dataclass(frozen=True)
class Row:
    """Some work, and what it may cost.

    Parameters
    ----------
    work
        Is called without arguments.
    pixels
        Number of pixels.
    limit, unit
        Largest cost; of ``copies``, ``us`` a pixel, or times the cost of the row of that name.
    """

    work: Callable[[], Any]
    pixels: int
    limit: float = math.nan
    unit: str = "us"


def dome(count: int) -> Float32:
    """Return directions ``(N, 3)`` spread over a dome by the golden angle."""
    z = np.linspace(0.97, 0.5, count)
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1).astype(np.float32)


def plane(side: int) -> Float64:
    """Return points ``(H, W, 3)`` of the working plane, mm, whose rows repeat."""
    x, y = np.meshgrid(np.linspace(-70, 70, side), np.linspace(70, -70, _ROWS))
    strip = np.stack([x, y, 0 * x], axis=2)
    return strip[np.arange(side) % _ROWS]


def images(lights: Lights, side: int, *, gloss: bool) -> Float32:
    """Return images ``(N, H, W)`` of a relief whose rows repeat."""
    return repeated(strips(lights, side, gloss=gloss), side)


def repeated(rows: Float32, side: int) -> Float32:
    """Return images ``(..., H, W)`` whose rows repeat those given."""
    return np.ascontiguousarray(rows[..., np.arange(side) % _ROWS, :])


def strips(lights: Lights, side: int, *, gloss: bool, seed: int = 0) -> Float32:
    """Return the first rows ``(N, 128, W)`` of `images`."""
    rng = np.random.default_rng(seed)
    values = np.zeros((len(lights), min(_ROWS, side), side), np.float32)
    y, x = np.mgrid[: min(_ROWS, side), :side].astype(np.float32)
    normals = np.stack([0.8 * np.sin(x / 9), 0.8 * np.cos(y / 13), np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    points = plane(side)[: len(x)] if lights.near else np.zeros((1, 1, 3))
    for i, strip in enumerate(values):
        of_light = lights.take([i]).vectors_at(points.reshape(-1, 3))
        vectors = of_light.reshape(*points.shape).astype(np.float32)
        shading = np.maximum((normals * vectors).sum(axis=-1), 0)
        strip[:] = 0.6 * shading
        if gloss:
            half = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
            half = half + np.float32([0, 0, 1])
            along = (normals * half).sum(axis=-1) / np.linalg.norm(half, axis=-1)
            strip += 0.6 * shading * np.maximum(along, 0) ** 40
        strip += rng.normal(0, _NOISE, x.shape)
    return values


def naive(values: Float32, directions: Float32) -> Any:
    """Solve plain least squares as a first version of a program would."""
    samples = values.reshape(len(values), -1).astype(np.float64)
    return np.linalg.lstsq(directions.astype(np.float64), samples, rcond=None)[0]


def kernels(
    count: int, side: int, methods: Sequence[Method], limits: dict[str, float]
) -> Iterator[tuple[str, Row]]:
    """Yield the rows of the estimators under distant and near lights."""
    directions = dome(count)
    distant, mask = Lights(directions), np.ones((side, side), bool)
    near = Lights(positions_mm=directions * 450, mu=np.full(count, 1.0))
    points = plane(side)
    for surface in ("matte", "glossy"):
        gloss = surface == "glossy"
        values, of_near = (images(lights, side, gloss=gloss) for lights in (distant, near))
        solve = partial(photometric_stereo, values, distant, mask)
        solve_near = partial(photometric_stereo, of_near, near, mask, points_mm=points)
        for method in methods:
            if method == "ls" and gloss:
                continue
            name = f"{method}, {surface}"
            unit = "copies" if method == "ls" else "us"
            yield (
                name,
                Row(partial(solve, method=method), mask.size, limits.get(method, math.nan), unit),
            )
            limit = (limits["near ls"], "us") if method == "ls" else (1.5, name)
            yield f"{name}, near", Row(partial(solve_near, method=method), mask.size, *limit)
        if "ls" in methods and not gloss:
            yield "lstsq, float64", Row(partial(naive, values, directions), mask.size)
        if "cauchy" in methods:
            solved = solve_near(method="cauchy")
            bars = partial(normal_uncertainty, of_near, near, mask, solved, points_mm=points)
            name = f"error bars, {surface}, near"
            yield name, Row(bars, mask.size, 0.5, f"cauchy, {surface}, near")


def session(folder: Path, lights: Lights, side: int, *, gloss: bool = False, seed: int = 0) -> None:
    """Record a session of images, and write lights and a mask next to it."""
    write_lights(folder.with_suffix(".json"), lights)
    write_mask(folder.with_suffix(".png"), np.ones((side, side), bool))
    values = strips(lights, side, gloss=gloss, seed=seed)

    def frame(_: int, shot: PlannedShot) -> UInt16:
        lit = values[shot.led] if shot.role == "light" else 0 * values[0]
        return repeated(np.clip(np.rint(_BLACK + _PER_SIGNAL * lit), 0, 4095).astype("u2"), side)

    write_session(
        folder,
        "relief",
        frame,
        lights=len(lights),
        size=(side, side),
        exposures_us=(20_000.0,),
        black_level_dn=_BLACK,
        read_noise_e=2.5 * _NOISE * _PER_SIGNAL,
    )


def print_row(name: str, row: Row, cost: Cost, copy: float, of: float) -> None:
    """Print one line; ``of`` is the cost of the row with which this one is compared."""
    us = cost.cpu_s / row.pixels * 1e6
    value = {"us": us, "copies": cost.cpu_s / copy}.get(row.unit, cost.cpu_s / of)
    limit = ""
    if not math.isnan(row.limit):
        unit = row.unit if row.unit in ("us", "copies") else f"x {row.unit}"
        verdict = "" if value <= row.limit else "  above"
        limit = f"{value:8.2f}  {row.limit:5.2f} {unit}{verdict}"
    beyond = (cost.peak_bytes - _OF_MAPS * row.pixels) / 1e6
    print(f"{name:28}{cost.cpu_s:8.2f}{us:8.3f}{cost.cpu_s / copy:8.1f}{beyond:8.0f}{limit}")


def table(rows: dict[str, Row], stack: Float32, rounds: int) -> None:
    """Measure the rows in turn, several times, and print the least costs."""
    costs: dict[str, list[Cost]] = {name: [] for name in rows}
    copies: list[float] = []
    for _ in range(rounds):
        copies.append(copy_s(stack))
        for name, row in rows.items():
            costs[name].append(measured(row.work)[0])
            if costs[name][0].cpu_s < _SHORT_S:
                costs[name].append(measured(row.work, runs=_AGAIN)[0])
    least = {
        name: Cost(*map(min, zip(*((c.cpu_s, c.wall_s, c.peak_bytes) for c in of), strict=True)))
        for name, of in costs.items()
    }
    print(f"{'':28}{'CPU s':>8}{'us/px':>8}{'copies':>8}{'beyond':>8}{'':4}cost  limit")
    for name, row in rows.items():
        of = least[row.unit].cpu_s if row.unit in least else math.nan
        print_row(name, row, least[name], min(copies), of)


def linear(count: int, largest: float, rounds: int) -> None:
    """Print the time per pixel of images of several sizes."""
    lights = Lights(dome(count))
    sizes = [size for size in _SIZES if size <= largest]
    print(f"\n{'us/px by megapixels':28}" + "".join(f"{size:8g}" for size in sizes) + "  ratio")
    spent: dict[Method, list[float]] = {"ls": [], "cauchy": [], "best": []}
    for size in sizes:
        side = round(math.sqrt(size * 1e6))
        values, mask = images(lights, side, gloss=True), np.ones((side, side), bool)
        for method, of_method in spent.items():
            runs = [
                measured(partial(photometric_stereo, values, lights, mask, method=method))[0]
                for _ in range(rounds if size < _LARGE else 1)
            ]
            of_method.append(min(run.cpu_s for run in runs) / mask.size * 1e6)
    for method, of_method in spent.items():
        figures = "".join(f"{us:8.3f}" for us in of_method)
        print(f"{method:28}{figures}{of_method[-1] / of_method[0]:7.2f}")


def whole_command(count: int, megapixels: float, rounds: int) -> None:
    """Print the cost of `sgp normals` on a session, and that of its solver."""
    lights, side = Lights(dome(count)), round(math.sqrt(megapixels * 1e6))
    with tempfile.TemporaryDirectory(prefix="sgp-costs-") as name:
        folder = Path(name) / "session"
        session(folder, lights, side)
        stack, mask = linear_stack(read_source(folder)), np.ones((side, side), bool)
        words = [sys.executable, "-m", "sgp", "normals", str(folder), "--method", "cauchy"]
        words += ["--lights", str(folder.with_suffix(".json"))]
        words += ["--mask", str(folder.with_suffix(".png")), "--force"]
        words += ["--out", str(Path(name) / "out")]
        solver, command = [], []
        for _ in range(rounds):
            cost, _ = measured(
                lambda: photometric_stereo(
                    stack.values, lights, mask, method="cauchy", noise=stack.noise
                )
            )
            solver.append(cost.cpu_s)
            command.append(command_cost(words)[0])
    print(
        f"\nsgp normals SESSION {min(command):.1f} CPU s, its solver cauchy {min(solver):.1f}: "
        f"{min(command) / min(solver):.2f} times (limit 2.5)",
        flush=True,
    )


def main() -> None:
    """Print the tables."""
    parser = command_line(__doc__)
    parser.add_argument("--megapixels", type=float, default=5.0, help="megapixels per image")
    parser.add_argument("--lights", type=int, default=36, help="number of images")
    parser.add_argument("--largest", type=float, default=20.0, help="megapixels, largest image")
    parser.add_argument("--rounds", type=int, default=3, help="rounds, of which the least counts")
    parser.add_argument(
        "--tables", nargs="+", choices=_TABLES, default=_TABLES, help="tables to print"
    )
    options = parser.parse_args()
    side = round(math.sqrt(options.megapixels * 1e6))
    dict(kernels(6, 128, METHODS, _LIMITS))["ls, matte"].work()  # compiles
    for name, count, of_side, methods, limits in (
        ("kernels", options.lights, side, METHODS, _LIMITS),
        ("kernels-96", 96, side // 2, ("best",), _LIMITS_96),
    ):
        if name not in options.tables:
            continue
        rows = dict(kernels(count, of_side, methods, limits))
        stack = np.ones((count, of_side, of_side), np.float32)
        print(f"\n{count} lights, {of_side**2 / 1e6:.2f} megapixels", flush=True)
        table(rows, stack, options.rounds)
        del rows, stack
    if "command" in options.tables:
        whole_command(options.lights, options.megapixels, options.rounds)
    if "linear" in options.tables:
        linear(options.lights, options.largest, options.rounds)


if __name__ == "__main__":
    main()
