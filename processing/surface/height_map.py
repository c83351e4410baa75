"""A surface over the pixels of an image."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from acquisition import CameraModel, MapRows
from acquisition.files import rows_in_bands
from processing.surface.height_errors import HeightUncertainty
from processing.surface.jumps import Jumps
from rig import Notice
from rig.arrays import Bool, Float32, Int32

# Values that are read at once.
_READ = 4_000_000


class BlockFigures(NamedTuple):
    """How a surface was solved in blocks.

    Parameters
    ----------
    number
        Number of blocks.
    rounds
        Number of rounds in which blocks were corrected by their neighbours.
    error
        Estimated largest difference from the surface that is integrated as a whole, in its unit.
    """

    number: int
    rounds: int
    error: float


@dataclass(frozen=True, eq=False)
class HeightMap:
    """A surface over the pixels of an image.

    Parameters
    ----------
    maps
        The maps ``height``, ``parts`` and, of a perspective surface, ``depth``, in memory or in
        files; the properties describe them.
    mask
        ``(H, W)`` bool, the pixels with a known height.
    unit
        ``mm``, or ``px`` if the scale is not known.
    pixel_size
        Distance between neighbouring pixels in `unit`; with a camera, at the working distance.
    camera
        The camera of a perspective surface.
    iterations, relative_residual
        Number of iterations and final residual of the linear solver, in blocks in that with the
        largest residual.
    warnings
        Separate parts, pixels without a height, doubts about the solution, and normals that are
        not those of one surface.
    disagreement_deg
        Median angle between the given normals and those of the surface, along pixel edges.
    curl
        Disagreement of the mixed derivatives of the normals, see `Integrability`: 0 for those of a
        surface. NaN if too few normals face the camera.
    jumps
        Where the surface jumps in depth; None if jumps were not looked for.
    uncertainty
        Standard deviations of heights and of differences; None if they were not requested.
    blocks
        How it was solved in blocks of rows; None if it was solved as a whole.
    """

    maps: Mapping[str, MapRows]
    mask: Bool
    unit: Literal["mm", "px"]
    pixel_size: float
    camera: CameraModel | None
    iterations: int
    relative_residual: float
    warnings: tuple[Notice, ...]
    disagreement_deg: float = math.nan
    curl: float = math.nan
    jumps: Jumps | None = None
    uncertainty: HeightUncertainty | None = None
    blocks: BlockFigures | None = None

    def __repr__(self) -> str:
        shape = f"float32{list(self.mask.shape)}"
        return f"HeightMap({shape} in {self.unit}, pixel size {self.pixel_size:.4g} {self.unit})"

    @property
    def height(self) -> Float32:
        """``(H, W)`` float32 along +Z toward the camera, in `unit`, NaN outside the mask.

        Without a camera the mean over each part is 0; with a camera the height is the working
        distance minus the depth.
        """
        return self.maps["height"][:]

    @property
    def depth(self) -> Float32 | None:
        """``(H, W)`` float32 distance from the camera along the optical axis, in `unit`.

        NaN outside the mask; None for an orthographic surface.
        """
        return self.maps["depth"][:] if "depth" in self.maps else None

    @property
    def parts(self) -> Int32:
        """``(H, W)`` int32 number of the connected part of each pixel, from 0; -1 outside the mask.

        The heights of parts relative to each other are not known.
        """
        return self.maps["parts"][:]

    @cached_property
    def part_count(self) -> int:
        """Number of connected parts."""
        return 1 + max(int(self.maps["parts"][rows].max()) for rows in self._bands())

    @cached_property
    def extremes(self) -> tuple[float, float]:
        """Lowest and highest height."""
        ends = [
            (values.min(), values.max())
            for rows in self._bands()
            if len(values := self.maps["height"][rows][self.mask[rows]])
        ]
        return float(min(low for low, _ in ends)), float(max(high for _, high in ends))

    def _bands(self) -> list[slice]:
        height, width = self.mask.shape
        return rows_in_bands(height, width, _READ)

    def points(self, rows: slice = slice(None)) -> Float32:
        """Return the surface points ``(H, W, 3)`` float32 in the house frame, NaN outside.

        Parameters
        ----------
        rows
            Rows of the map; the default is all of them.
        """
        first, last, _ = rows.indices(len(self.mask))
        rows = slice(first, last)
        height, columns = self.mask.shape
        inside, down = self.mask[rows], np.arange(first, last)
        points = np.full((*inside.shape, 3), np.nan, np.float32)
        points[..., 2] = self.maps["height"][rows]
        if self.camera is not None and "depth" in self.maps:
            x, y = np.meshgrid(np.arange(columns), down)
            rays = self.camera.rays(np.stack([x, y], axis=-1))
            points[..., :2] = rays[..., :2] * self.maps["depth"][rows][..., None]
        else:
            x = (np.arange(columns) - (columns - 1) / 2) * self.pixel_size
            y = ((height - 1) / 2 - down) * self.pixel_size
            points[..., 0] = np.where(inside, x[None, :], np.nan)
            points[..., 1] = np.where(inside, y[:, None], np.nan)
        return points
