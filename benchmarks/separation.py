"""What separation and transfer cost, in CPU seconds, copies of the map and memory.

CPU seconds are of all threads together, the least of three runs with warm caches; set
NUMBA_NUM_THREADS for their number. "copies" are CPU seconds over those of a copy of the map, "maps"
the growth of peak memory over the map's own bytes (on Linux); the outputs of a separation are two
maps, of a transfer (``combine``) one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import cast

import numba
import numpy as np
from harness import command_line, measured

from processing import FilterKind, NormalMap, ShapeFilter, combine, separate


def relief(megapixels: float) -> NormalMap:
    """Waves all over the frame under noise of 6 degrees."""
    height, width = (round((megapixels * 1e6 * side) ** 0.5) for side in (4 / 5, 5 / 4))
    y, x = np.mgrid[:height, :width].astype(np.float32)
    vectors = np.random.default_rng(0).standard_normal((height, width, 3), np.float32) * 0.1
    vectors[..., 0] += 0.4 * np.sin(x / 40)
    vectors[..., 1] += 0.4 * np.sin(y / 50)
    vectors[..., 2] += 1
    vectors /= np.sqrt(np.einsum("ijk,ijk->ij", vectors, vectors))[..., None]
    return NormalMap(vectors, np.ones((height, width), np.bool_))


def cases(given: NormalMap, filters: list[str], w: int) -> dict[str, Callable[[], object]]:
    made: dict[str, Callable[[], object]] = {"copy": given.normals.copy}
    for name in filters:
        kind, order = name.split("-")
        by = ShapeFilter(cast(FilterKind, kind), int(order), w)
        made[f"separate {name}"] = partial(by.split, given)
    parts = separate(given, order=1, w=w)
    made["combine"] = partial(combine, parts.shape, parts.detail)
    return made


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument(
        "--megapixels", type=float, nargs="+", default=[0.3, 1.0, 5.0, 20.0], help="of each map"
    )
    parser.add_argument("--w", type=int, default=5, help="half width of the window in pixels")
    parser.add_argument(
        "--filters", nargs="+", default=["gaussian-1", "gaussian-8"], help="kind-order"
    )
    options = parser.parse_args()
    print(f"{numba.get_num_threads()} threads, w={options.w}\n")
    print(f"{'':25}{'CPU s':>8}{'ns/px':>8}{'copies':>8}{'maps':>8}")
    for megapixels in options.megapixels:
        given = relief(megapixels)
        copy = 0.0
        for name, work in cases(given, options.filters, options.w).items():
            work()
            cost, _ = measured(work, runs=3)
            copy = copy or cost.cpu_s
            print(
                f"{f'{megapixels:g} Mpx {name}':25}{cost.cpu_s:8.4f}"
                f"{cost.cpu_s / given.mask.size * 1e9:8.1f}{cost.cpu_s / copy:8.1f}"
                f"{cost.peak_bytes / given.normals.nbytes:8.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
