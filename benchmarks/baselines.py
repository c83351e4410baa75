"""Compare detail transfer in the normal domain with two mesh-based peers, in one run.

The detail of a woven cloth is transferred onto a bowl with the given number of points. DSPL is
displacement along normals, LAPL is Laplacian editing. Each number of points is measured in a
process of its own with warm caches: CPU seconds of all threads, and peak of the resident memory
above the inputs. Times are medians with the minimum and maximum of the runs. A repeated call reuses
results that depend only on the target: shape or smooth base, factors of a matrix. "x" is the ratio
to "normals" (separation of both maps by the paper's filter, and transfer), median over median; for
the first call also minimum over maximum and maximum over minimum.

LAPL is solved by multigrid; "direct solver" is SuperLU. CHOLMOD, which is under the GPL, runs in a
process of its own if cvxopt is installed.

Afterwards errors in degrees by the paper's filter are printed, three times a shape and a detail
error: against the two maps; with every method starting from the same surfaces; with every result
as a surface. See docs/paper-tables.md. "round trip" converts normals to a surface and back, without
a transfer.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from statistics import median

import numpy as np
from harness import command_line, copy_s

from benchmarks.paper.judge import AS_SURFACES, PLAIN, SAME_SURFACES, judge
from benchmarks.paper.measure import IN_NORMALS, METHODS, Measured, measure
from benchmarks.paper.peers import lapl_by_cholmod
from processing import NormalMap
from simulator.shapes import Textile

ERRORS = (*PLAIN[::2], *SAME_SURFACES, *AS_SURFACES)


def pair(points: int) -> tuple[NormalMap, NormalMap]:
    """Return the normals of a cloth with 6 pixels per yarn, and those of a bowl."""
    side = round(points**0.5)
    x, y = np.meshgrid(np.arange(side) - (side - 1) / 2, (side - 1) / 2 - np.arange(side))
    _, slope_x, slope_y = Textile(side, 1.0).evaluate(x, y)
    one = np.ones_like(x)
    cloth = NormalMap.from_vectors(np.stack([-slope_x, -slope_y, one], axis=2))
    return cloth, NormalMap.from_vectors(np.stack([-x, -y, side * one], axis=2))


def all_measured(source: NormalMap, target: NormalMap, runs: int) -> dict[str, Measured]:
    results = measure((*METHODS, "LAPL, direct solver"), source, target, runs=runs)
    if find_spec("cvxopt") is not None:
        script = Path(lapl_by_cholmod.__file__)
        method = lapl_by_cholmod.METHOD
        results |= measure((method,), source, target, runs=runs, script=script)
    return results


def spread(values: tuple[float, ...]) -> str:
    return f"{median(values):.4f} ({min(values):.4f}..{max(values):.4f})"


def print_costs(points: int, results: dict[str, Measured], one_copy: float) -> None:
    ours = results["normals"]
    for method, taken in sorted(results.items()):
        first, again = taken.cpu_s, taken.again_cpu_s
        times = [f"{median(first) / median(ours.cpu_s):.1f}"]
        times.append(f"{min(first) / max(ours.cpu_s):.1f}..{max(first) / min(ours.cpu_s):.1f}")
        times.append(f"{median(again) / median(ours.again_cpu_s):.1f}")
        memory = [size / 1e6 for size in taken.peak_bytes] or [float("nan")]
        yardstick = median(ours.peak_bytes) / 1e6 if ours.peak_bytes else float("nan")
        print(
            f"{points:7d} {method:20}{spread(first):>26}{times[0]:>8}{times[1]:>14}"
            f"{spread(again):>26}{times[2]:>8}{median(memory):8.1f}"
            f"{median(memory) / yardstick:8.1f}{median(first) / one_copy:8.0f}",
            flush=True,
        )


def print_errors(
    points: int, results: dict[str, Measured], source: NormalMap, target: NormalMap
) -> None:
    judged = judge(
        {name: one.normal_map for name, one in results.items()}, source, target, IN_NORMALS
    )
    for method in judged[ERRORS[0]]:
        figures = [judged[quantity].get(method) for quantity in ERRORS]
        cells = ["" if figure is None else f"{figure:.2f}" for figure in figures]
        print(f"{points:7d} {method:28}" + "".join(f"{cell:>10}" for cell in cells), flush=True)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument(
        "--points", type=int, nargs="+", default=[5010, 49532, 306491], help="points per map"
    )
    parser.add_argument("--runs", type=int, default=5, help="runs per method")
    options = parser.parse_args()
    if find_spec("cvxopt") is None:
        print("cvxopt is not installed (it is under the GPL): LAPL by CHOLMOD is skipped")
    print(
        f"{'points':>7} {'method':20}{'CPU s':>26}{'x':>8}{'least..most':>14}"
        f"{'repeated':>26}{'x':>8}{'MB':>8}{'x':>8}{'copies':>8}"
    )
    done = []
    for points in options.points:
        source, target = pair(points)
        results = all_measured(source, target, options.runs)
        print_costs(int(source.mask.sum()), results, copy_s(source.normals))
        done.append((int(source.mask.sum()), results, source, target))
    print(f"\n{'errors in degrees':37}{'plain':>19}{'same surfaces':>20}{'as surfaces':>20}")
    print(f"{'points':>7} {'method':28}" + f"{'shape':>10}{'detail':>10}" * 3)
    for each in done:
        print_errors(*each)


if __name__ == "__main__":
    main()
