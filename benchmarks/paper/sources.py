"""The normal maps used instead of the paper's: maps in the folder SGP_DATA, and simulated ones."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import processing
import simulator

DILIGENT = ("bear", "buddha", "cat", "cow", "goblet", "harvest")

_SIDE_PX = 512
# Radius of the simulated reliefs in mm: a smaller radius gives more pixels per yarn or scale.
_CLOTH_MM, _SKIN_MM, _WOOD_MM = 200.0, 200.0, 80.0


@dataclass(frozen=True)
class Sources:
    """Sources of normal maps.

    Parameters
    ----------
    data
        Data folder, or None to simulate all maps.
    files
        Files read so far.
    """

    data: Path | None
    files: set[Path] = field(default_factory=set)

    @classmethod
    def found(cls) -> Sources:
        """Use the folder in the environment variable SGP_DATA, if it is set."""
        named = os.environ.get("SGP_DATA")
        return cls(Path(named) if named else None)

    def textures(self) -> dict[str, processing.NormalMap]:
        """Return the surfaces whose detail is measured, by name."""
        measured = (
            {} if self.data is None else {name: self.given(name) for name in ("owl", "plant")}
        )
        return measured | {
            "scales (simulated)": relief(simulator.shapes.LizardScales(_SKIN_MM, outline="square")),
            "cloth (simulated)": relief(simulator.shapes.Textile(_CLOTH_MM, outline="square")),
            "carving (simulated)": relief(simulator.shapes.WoodCarving(_WOOD_MM, outline="square")),
        }

    def targets(self) -> dict[str, processing.NormalMap]:
        """Return the DiLiGenT targets by name; none without data."""
        return (
            {} if self.data is None else {name: self.given(f"diligent/{name}") for name in DILIGENT}
        )

    def target(self, points: int) -> tuple[str, processing.NormalMap]:
        """Return the cat of DiLiGenT with its name, or a bowl with about this number of points."""
        if self.data is None:
            return "bowl (simulated)", bowl(points)
        return "cat", self.given("diligent/cat")

    def resolution_pair(
        self, points: int
    ) -> tuple[str, processing.NormalMap, processing.NormalMap]:
        """Return names, a dense relief, and a target with about this number of points.

        These are cracks and the bunny if there are data, else a simulated cloth and bowl.
        """
        if self.data is None:
            return (
                "cloth onto a bowl, both simulated",
                self.textures()["cloth (simulated)"],
                bowl(points),
            )
        return "cracks onto bunny", self.cracks(), self._bunny(points)

    def given(self, name: str) -> processing.NormalMap:
        """Read a normal map of the data.

        Raises
        ------
        MissingPathError
            If the file does not exist.
        """
        return self._read(f"normals/{name}")

    def cracks(self) -> processing.NormalMap:
        """Read a dense relief that is larger than all targets, so that it is not repeated."""
        return self.relief("160")

    def relief(self, name: str) -> processing.NormalMap:
        """Read a relief of the data."""
        return self._read(f"reliefs/{name}.jpg")

    def _read(self, name: str) -> processing.NormalMap:
        read = processing.read_normals((self.data or Path()) / name)
        self.files.update(read.files)
        return read.normal_map

    def _bunny(self, points: int) -> processing.NormalMap:
        file = (self.data or Path()) / "meshes" / "stanford-bunny.obj"
        mesh = processing.read_geometry(file)
        self.files.add(file)
        span = float(np.ptp(mesh.vertices, axis=0)[:2].max())
        step = span / 128
        for _ in range(2):
            drawn = processing.project(mesh, pixel_mm=step).normal_map
            step *= math.sqrt(np.count_nonzero(drawn.mask) / points)
        return processing.project(mesh, pixel_mm=step).normal_map


def bowl(points: int) -> processing.NormalMap:
    """Return a spherical cap, cut at 60 degrees, with about this number of points."""
    radius = math.sqrt(points / math.pi)
    return relief(
        simulator.shapes.SphericalCap(radius, radius / math.sqrt(3)),
        round(2 * radius) + 2,
        radius + 1,
    )


def relief(
    surface: simulator.shapes.Surface, side_px: int = _SIDE_PX, reach_mm: float | None = None
) -> processing.NormalMap:
    """Return the normals of a height field seen from above, computed from its exact gradients."""
    reach = surface.radius_mm / math.sqrt(2) if reach_mm is None else reach_mm
    along = (np.arange(side_px) + 0.5 - side_px / 2) * (2 * reach / side_px)
    x, y = np.meshgrid(along, -along)
    inside = surface.inside(x, y)
    _, slope_x, slope_y = surface.evaluate(np.where(inside, x, 0), np.where(inside, y, 0))
    vectors = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=2)
    return processing.NormalMap.from_vectors(vectors, inside)
