"""Lizard scales and textile of the simulator on real shapes: figures, and pictures for the docs.

The exemplars are 256 x 256 pixels. The targets, in the folder SGP_DATA, are DiLiGenT's cat and the
head of Max Planck, projected from a mesh. The pattern has 0.6 times the size of the exemplar. For
each pair the table has the mean detail angle of the result relative to that of the exemplar, the
step across cuts over that inside patches, the mean angle between the shapes of target and result,
the share of pixels whose pattern is smaller than intended, and CPU seconds, which contain the time
for compiling in the first row. With --out, the exemplar, the target, the result, and its surface
seen from the side are drawn.

    python benchmarks/synthesis_onto.py --out docs
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from harness import command_line, measured
from matplotlib.axes import Axes

import processing
from benchmarks.paper.exemplars import materials
from processing import NormalMap
from sgp.pictures import Panel, write_overview

LIGHT = np.array([-0.45, 0.5, 0.74])
SIZE = 420, 420
MATERIALS = {"lizard": "lizard scales", "textile": "textile"}


def targets(data: Path) -> dict[str, NormalMap]:
    cat = processing.read_normals(data / "normals" / "diligent" / "cat").normal_map
    mesh = processing.read_geometry(data / "meshes" / "decimated-max.obj")
    # The face looks along -Z of the file.
    head = processing.project(mesh, processing.projection.view_rotation("back"), size=SIZE)
    return {"cat": cat, "max": head.normal_map}


def from_the_side(normals: NormalMap) -> NormalMap:
    """Return the surface of normals, turned by 20 degrees about the vertical."""
    made = processing.height_mesh(processing.integrate(normals))
    solid = processing.Geometry(made.vertices.astype(np.float64), made.faces)
    turn = processing.projection.view_rotation("front", rotate_deg=(0, 20, 0))
    return processing.project(solid, turn, size=SIZE).normal_map


def lit(title: str, part: NormalMap) -> Panel:
    rows, columns = (np.flatnonzero(part.mask.any(axis=axis)) for axis in (1, 0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    shade = np.clip(part.normals[window].astype(np.float64) @ LIGHT, 0, 1)
    shade[~part.mask[window]] = 1

    def draw(axes: Axes) -> None:
        axes.imshow(shade, cmap="gray", vmin=0, vmax=1, interpolation="bicubic")
        axes.axis("off")

    return Panel(title, draw)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--out", type=Path, help="folder for the pictures")
    parser.add_argument("--seed", type=int, default=7, help="seed of the materials")
    options = parser.parse_args()
    exemplars = materials(options.seed)
    print("material and target  detail angle  steps  shape error  compressed  CPU s")
    for name, target in targets(Path(os.environ["SGP_DATA"])).items():
        shape = processing.ShapeFilter().shape(target)
        scale = np.full(shape.size, 0.6)
        for short, long in MATERIALS.items():
            exemplar = processing.separate(exemplars[long]).detail
            cost, made = measured(partial(processing.synthesize_onto, exemplar, shape, scale=scale))
            figures = processing.synthesis.texture_figures(made.detail, exemplar, patch=made.patch)
            normals = processing.combine(shape, made.detail)
            again = processing.separate(normals)
            error = processing.detail.TransferFidelity(shape, made.detail, again).shape_mae_deg
            change = figures.detail_angle_deg / figures.exemplar_angle_deg - 1
            print(
                f"{short + ' on ' + name:20} {change:+12.1%} {made.steps.ratio:6.2f} "
                f"{error:8.2f} deg {made.compressed:11.1%} {cost.cpu_s:6.2f}",
                flush=True,
            )
            if options.out is None:
                continue
            panels = [
                lit("exemplar", exemplar),
                lit("target", target),
                lit("result", normals),
                lit("its surface", from_the_side(normals)),
            ]
            path = options.out / f"synthesis-{short}-{name}.png"
            write_overview(path, "", panels, columns=4)
            # The picture is grey: a third of the bytes.
            cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))


if __name__ == "__main__":
    main()
