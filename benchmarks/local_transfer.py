"""Faces set into other surfaces: figures of the seam, and the pictures in docs/detail.md.

The faces need the folder SGP_DATA. For each pair the first table has the angular step across the
seam relative to that inside, with and without the membrane; the detail error over the region by the
separation's own filter and by the paper's; and CPU seconds with warm caches. Each picture shows the
placed source, the target, the pasted part, and the blended part. Then the costs of a part with
about the given number of pixels in a target 4 times as large are printed: CPU seconds of all
threads, the same in copies of the target's map, and the peak of resident memory.
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from harness import command_line, copy_s, measured
from matplotlib.axes import Axes

from benchmarks.paper.faces import FACES
from processing import NormalMap, read_normals, transfer_local
from processing.detail import Pose
from sgp.pictures import Panel, write_overview

# Section of the target in the pictures: first column, first row, side.
VIEW = (215, 92, 180)


def shaded(title: str, normal_map: NormalMap) -> Panel:
    """Return a panel of the normals, lit from the upper left."""
    x, y, side = VIEW
    shade = np.clip(normal_map.normals @ np.array([-0.4, 0.5, 0.77], np.float32), 0, 1)
    shade[~normal_map.mask] = 1

    def draw(axes: Axes) -> None:
        part = shade[y : y + side, x : x + side]
        axes.imshow(part, cmap="gray", vmin=0, vmax=1, interpolation="bicubic")
        axes.axis("off")

    return Panel(title, draw)


def relief(side: int, seed: int) -> NormalMap:
    noise = np.random.default_rng(seed).normal(size=(side, side)).astype(np.float32)
    down, right = np.gradient(cv2.GaussianBlur(noise, (0, 0), 3))
    return NormalMap.from_vectors(np.stack([-8 * right, 8 * down, np.ones_like(down)], axis=2))


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--out", type=Path, help="folder for the pictures")
    parser.add_argument(
        "--pixels",
        type=int,
        nargs="*",
        default=[300_000, 1_000_000],
        help="pixels of the timed parts",
    )
    options = parser.parse_args()
    if "SGP_DATA" in os.environ:
        folder = Path(os.environ["SGP_DATA"]) / "normals" / "diligent"
        print("pair           | seam/interior | pasted | detail error (paper's filter) | CPU s")
        for face in FACES.values():
            source, target = (
                read_normals(folder / name).normal_map for name in (face.source, face.target)
            )
            pasted = face.set_in(source, target, reach_px=1e-2)
            cost, done = measured(partial(face.set_in, source, target))
            print(
                f"{face.source:6} to {face.target:5}| {done.seam.ratio:13.2f} | "
                f"{pasted.seam.ratio:6.2f} | {done.fidelity.detail_mae_deg:.2f} "
                f"({done.fidelity_paper.detail_mae_deg:.2f}) deg               | {cost.cpu_s:.2f}"
            )
            if options.out is not None:
                panels = [
                    shaded(f"{face.source}, as placed", done.placed),
                    shaded(face.target, target),
                    shaded("pasted", pasted.normal_map),
                    shaded("blended", done.normal_map),
                ]
                options.out.mkdir(parents=True, exist_ok=True)
                name = f"local-{face.source}-{face.target}.png"
                write_overview(options.out / name, "", panels, columns=4)
    else:
        print("SGP_DATA is not set: no faces are measured")
    transfer_local(relief(64, 0), relief(64, 1))
    for pixels in options.pixels:
        side = round(np.sqrt(pixels))
        source, target = relief(side, 0), relief(2 * side, 1)
        cost, done = measured(partial(transfer_local, source, target, pose=Pose((side, side))))
        print(
            f"{int(done.region.sum())} pixels: {cost.cpu_s:.2f} CPU s, "
            f"{cost.cpu_s / copy_s(target.normals):.0f} copies, {cost.peak_mb:.0f} MB"
        )


if __name__ == "__main__":
    main()
