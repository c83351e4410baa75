"""Detail transfer in the normal domain beside two mesh-based peers, in one run.

A woven cloth's detail goes onto a bowl of so many points. Each number of points is measured in
a process of its own with warm caches: CPU seconds of all threads (the best run), peak of the
resident memory above the inputs, both also as multiples of those of "normals" (separation and
transfer by the paper's filter), the time also as multiples of a copy of a normal map.
Angles are errors by the paper's filter. DSPL: displacement along normals. LAPL: Laplacian editing.
"""

from __future__ import annotations

import numpy as np
from harness import command_line, copy_s

from processing import NormalMap, angle_deg, separate
from sgp._paper.measure import METHODS, Method, measure
from simulator import Textile


def pair(points: int) -> tuple[NormalMap, NormalMap]:
    """A cloth of 6 pixels to the yarn, and a bowl."""
    side = round(points**0.5)
    x, y = np.meshgrid(np.arange(side) - (side - 1) / 2, (side - 1) / 2 - np.arange(side))
    _, slope_x, slope_y = Textile(side, 1.0).evaluate(x, y)
    one = np.ones_like(x)
    cloth = NormalMap.from_vectors(np.stack([-slope_x, -slope_y, one], axis=2))
    return cloth, NormalMap.from_vectors(np.stack([-x, -y, side * one], axis=2))


def rows(source: NormalMap, target: NormalMap, runs: int) -> dict[Method, tuple[float, ...]]:
    meant = separate(target, order=1).shape
    put = separate(source, order=1).detail
    found = {}
    for method, measured in measure(METHODS, source, target, runs=runs).items():
        parts = separate(measured.normal_map, order=1)
        found[method] = (
            min(measured.cpu_s),
            (measured.peak_bytes or float("nan")) / 1e6,
            float(angle_deg(parts.shape.normals, meant.normals).mean()),
            float(angle_deg(parts.detail.normals, put.normals).mean()),
        )
    return found


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument(
        "--points", type=int, nargs="+", default=[5010, 49532, 306491], help="of each map"
    )
    parser.add_argument("--runs", type=int, default=3, help="of each method")
    options = parser.parse_args()
    print(
        f"{'points':>8} {'method':18}{'CPU s':>9}{'MB':>9}{'x time':>9}{'x memory':>9}"
        f"{'copies':>9}{'shape deg':>10}{'detail deg':>11}"
    )
    for points in options.points:
        source, target = pair(points)
        found = rows(source, target, options.runs)
        one_copy = copy_s(source.normals)
        for method, (cpu, size, shape, detail) in found.items():
            print(
                f"{source.mask.sum():8d} {method:18}{cpu:9.4f}{size:9.1f}"
                f"{cpu / found['normals'][0]:9.1f}{size / found['normals'][1]:9.1f}"
                f"{cpu / one_copy:9.0f}{shape:10.2f}{detail:11.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
