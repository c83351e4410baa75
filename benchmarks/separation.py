"""Cost of separation and transfer, in CPU seconds, copies of the map and memory.

CPU seconds are those of all threads together, the minimum of three runs with warm caches;
NUMBA_NUM_THREADS sets the number of threads. "copies" is the ratio of the CPU seconds to those of a
copy of the map, "maps" the growth of the peak memory relative to the size of the map (on Linux).
The results of a separation are two maps, that of a transfer (``combine``) is one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import cast

import numba
import numpy as np
from harness import command_line, measured

from processing import NormalMap, ShapeFilter, combine, separate
from processing.detail import FilterKind


def relief(megapixels: float) -> NormalMap:
    """Return the normals of waves over the full frame with 6 degrees of noise."""
    height, width = (round((megapixels * 1e6 * side) ** 0.5) for side in (4 / 5, 5 / 4))
    y, x = np.mgrid[:height, :width].astype(np.float32)
    vectors = np.random.default_rng(0).standard_normal((height, width, 3), np.float32) * 0.1
    vectors[..., 0] += 0.4 * np.sin(x / 40)
    vectors[..., 1] += 0.4 * np.sin(y / 50)
    vectors[..., 2] += 1
    vectors /= np.sqrt(np.einsum("ijk,ijk->ij", vectors, vectors))[..., None]
    return NormalMap(vectors, np.ones((height, width), np.bool_))


def cases(normals: NormalMap, filters: list[str], w: int) -> dict[str, Callable[[], object]]:
    work: dict[str, Callable[[], object]] = {"copy": normals.normals.copy}
    for name in filters:
        kind, order = name.split("-")
        by = ShapeFilter(cast(FilterKind, kind), int(order), w)
        work[f"separate {name}"] = partial(by.split, normals)
    parts = separate(normals, shape_filter=ShapeFilter(order=1, w=w))
    work["combine"] = partial(combine, parts.shape, parts.detail)
    return work


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument(
        "--megapixels",
        type=float,
        nargs="+",
        default=[0.3, 1.0, 5.0, 20.0],
        help="megapixels per map",
    )
    parser.add_argument("--w", type=int, default=5, help="half width of the window in pixels")
    parser.add_argument(
        "--filters", nargs="+", default=["gaussian-1", "gaussian-8"], help="kind-order"
    )
    options = parser.parse_args()
    print(f"{numba.get_num_threads()} threads, w={options.w}\n")
    print(f"{'':25}{'CPU s':>8}{'ns/px':>8}{'copies':>8}{'maps':>8}")
    for megapixels in options.megapixels:
        normals = relief(megapixels)
        copy = 0.0
        for name, work in cases(normals, options.filters, options.w).items():
            work()
            cost, _ = measured(work, runs=3)
            copy = copy or cost.cpu_s
            print(
                f"{f'{megapixels:g} Mpx {name}':25}{cost.cpu_s:8.4f}"
                f"{cost.cpu_s / normals.mask.size * 1e9:8.1f}{cost.cpu_s / copy:8.1f}"
                f"{cost.peak_bytes / normals.normals.nbytes:8.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
