"""Ground truth of a rendered scene, with which estimates are compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Lights, NoiseModel
from rig import pluralize
from simulator._scene.lens import Lens

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Truth:
    """Exact geometry, reflectance, lights and sensor of a rendered scene.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit vectors inside the mask, 0 outside.
    height_mm
        ``(H, W)`` z of the surface point at the pixel's centre, NaN outside the mask.
    albedo
        ``(H, W)``, or ``(H, W, 3)`` if it has colour; 0 outside the mask.
    mask
        ``(H, W)`` pixels whose centre shows the object.
    sphere_masks
        ``(S, H, W)`` pixels whose centre shows the sphere.
    sphere_centres_mm, sphere_radii_mm
        ``(S, 3)`` centres and ``(S,)`` radii of the spheres.
    highlights_px
        ``(S, N, 2)`` position (x, y) of LED n mirrored in sphere s, NaN if it is not seen.
    lights, lens, noise
        Lights, lens and sensor of the scene.
    electrons_per_us
        Signal of a white surface under irradiance 1.
    shadows
        ``(N, H, W)`` True where light n does not reach the point at the pixel's centre, because
        the surface faces away from it or the light is blocked; None if shadows were not rendered.
    top
        Row of the image in which the maps begin.
    """

    normals: npt.NDArray[np.float32]
    height_mm: Array
    albedo: npt.NDArray[np.float32]
    mask: npt.NDArray[np.bool_]
    sphere_masks: npt.NDArray[np.bool_]
    sphere_centres_mm: Array
    sphere_radii_mm: Array
    highlights_px: Array
    lights: Lights
    lens: Lens
    noise: NoiseModel
    electrons_per_us: float
    shadows: npt.NDArray[np.bool_] | None = None
    top: int = 0

    def __repr__(self) -> str:
        lights, spheres = len(self.lights), len(self.sphere_radii_mm)
        shape = f"{self.normals.dtype}{list(self.normals.shape)}"
        return f"Truth({shape}, {pluralize(lights, 'light')}, {pluralize(spheres, 'sphere')})"

    @property
    def camera(self) -> CameraModel | None:
        """Camera of the lens; None for an orthographic lens."""
        return self.lens.camera

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of every map."""
        height, width = self.mask.shape
        return height, width

    @property
    def depth_mm(self) -> Array | None:
        """``(H, W)`` distance from the camera along the optical axis, NaN outside the mask.

        None for an orthographic lens.
        """
        return None if self.camera is None else self.lens.camera_z_mm - self.height_mm

    @property
    def points_mm(self) -> Array:
        """``(H, W, 3)`` surface points at the pixels' centres, NaN outside the mask."""
        height, width = self.size
        x, y = np.meshgrid(np.arange(width), self.top + np.arange(height))
        origins, rays = self.lens.origins_and_rays(x, y)
        return origins + (self.lens.camera_z_mm - self.height_mm)[..., None] * rays
