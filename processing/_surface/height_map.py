"""A surface over the pixels of an image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, MapRows
from processing._surface.height_errors import HeightUncertainty
from processing._surface.jumps import Jumps
from rig import Notice

Float = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class HeightMap:
    """A surface over the pixels of an image.

    Parameters
    ----------
    height
        ``(H, W)`` float32 along +Z toward the camera, in `unit`, NaN outside the mask. Without a
        camera the mean over each part is 0; with a camera the height is the working distance minus
        the depth.
    depth
        ``(H, W)`` float32 distance from the camera along the optical axis, in `unit`, NaN outside
        the mask; None for an orthographic surface.
    mask
        ``(H, W)`` bool, the pixels with a known height.
    parts
        ``(H, W)`` int32 number of the connected part of each pixel, from 0; -1 outside the mask.
        The heights of parts relative to each other are not known.
    unit
        ``mm``, or ``px`` if the scale is not known.
    pixel_size
        Distance between neighbouring pixels in `unit`; with a camera, at the working distance.
    camera
        The camera of a perspective surface.
    iterations, relative_residual
        Number of iterations and final residual of the linear solver.
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
    """

    height: Float
    depth: Float | None
    mask: npt.NDArray[np.bool_]
    parts: npt.NDArray[np.int32]
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

    def __repr__(self) -> str:
        shape = f"{self.height.dtype}{list(self.height.shape)}"
        return f"HeightMap({shape} in {self.unit}, pixel size {self.pixel_size:.4g} {self.unit})"

    def points(self, rows: slice = slice(None)) -> Float:
        """Return the surface points ``(H, W, 3)`` float32 in the house frame, NaN outside.

        Parameters
        ----------
        rows
            Rows of the map; the default is all of them.
        """
        first, last, _ = rows.indices(len(self.mask))
        return points_of_rows(self, slice(first, last))


class HeightRows(Protocol):
    """What a `HeightMap` and a surface in files have in common: maps of which rows are read."""

    @property
    def height(self) -> MapRows:
        """``(H, W)`` float32 as in `HeightMap`."""

    @property
    def depth(self) -> MapRows | None:
        """``(H, W)`` float32 as in `HeightMap`."""

    @property
    def mask(self) -> npt.NDArray[np.bool_]:
        """``(H, W)`` bool as in `HeightMap`."""

    @property
    def parts(self) -> MapRows:
        """``(H, W)`` int32 as in `HeightMap`."""

    @property
    def unit(self) -> Literal["mm", "px"]:
        """Unit of the heights."""

    @property
    def pixel_size(self) -> float:
        """Distance between neighbouring pixels."""

    @property
    def camera(self) -> CameraModel | None:
        """The camera of a perspective surface."""

    @property
    def jumps(self) -> Jumps | None:
        """Where the surface jumps in depth."""

    @property
    def disagreement_deg(self) -> float:
        """Median angle between the given normals and those of the surface."""


def points_of_rows(surface: HeightRows, rows: slice) -> Float:
    """Return the surface points ``(h, W, 3)`` of rows, from ``rows.start`` to ``rows.stop``."""
    height, columns = surface.mask.shape
    inside = surface.mask[rows]
    down = np.arange(rows.start, rows.stop)
    points = np.full((*inside.shape, 3), np.nan, np.float32)
    points[..., 2] = surface.height[rows]
    if surface.camera is not None and surface.depth is not None:
        x, y = np.meshgrid(np.arange(columns), down)
        rays = surface.camera.rays(np.stack([x, y], axis=-1))
        points[..., :2] = rays[..., :2] * surface.depth[rows][..., None]
    else:
        x = (np.arange(columns) - (columns - 1) / 2) * surface.pixel_size
        y = ((height - 1) / 2 - down) * surface.pixel_size
        points[..., 0] = np.where(inside, x[None, :], np.nan)
        points[..., 1] = np.where(inside, y[:, None], np.nan)
    return points
