"""Lizard scales and textile of the simulator on real shapes: pictures and figures.

The exemplars are 256 x 256 pixels. The targets are DiLiGenT's cat and the head of Max Planck,
projected from a mesh; both need the folder SGP_DATA. For each pair the table has the mean detail
angle of the result relative to that of the exemplar, the step across cuts over that inside patches,
the mean angle between the shapes of target and result, that between the detail and the detail that
is separated from the result again, the share of pixels whose pattern is smaller, and CPU seconds.
The first row contains the time for compiling. With --out, the pictures in docs/detail.md are
written: the exemplar, the target, the result, and its surface from the side.

    python benchmarks/synthesis_onto.py --out docs
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
from harness import command_line, measured
from matplotlib.axes import Axes
from synthesis import material

import processing
from processing import NormalMap
from sgp._overview import Panel, write_overview

# Direction toward the light, and the turn of the surfaces around the vertical.
LIGHT = np.array([-0.45, 0.5, 0.74])
TURN_DEG = 35.0


def targets(data: Path) -> dict[str, NormalMap]:
    cat = processing.read_normals(data / "normals" / "diligent" / "cat").normal_map
    mesh = processing.read_mesh(data / "meshes" / "decimated-max.obj")
    head = processing.project_mesh(mesh, width=420, height=480).normal_map
    return {"cat": cat, "max": head}


def gray(title: str, shade: npt.NDArray[np.float64]) -> Panel:
    def draw(axes: Axes) -> None:
        axes.imshow(shade, cmap="gray", vmin=0, vmax=1, interpolation="bicubic")
        axes.axis("off")

    return Panel(title, draw)


def lit(title: str, part: NormalMap) -> Panel:
    rows, columns = (np.flatnonzero(part.mask.any(axis=axis)) for axis in (1, 0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    shade = np.clip(part.normals[window].astype(np.float64) @ LIGHT, 0, 1)
    return gray(title, np.where(part.mask[window], shade, 1))
