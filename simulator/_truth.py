"""What a rendering knows about its scene: the values every estimate is judged by."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Lights, NoiseModel, StorageError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Truth:
    """Exact geometry, reflectance, lights and sensor of a rendered scene.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit inside the mask, 0 outside.
    height_mm
        ``(H, W)`` z of the surface point at the pixel's centre, NaN outside the mask.
    albedo
        ``(H, W)``, 0 outside the mask.
    mask
        ``(H, W)`` pixels whose centre shows the object.
    sphere_masks
        ``(S, H, W)`` pixels whose centre shows the sphere.
    sphere_centres_mm, sphere_radii_mm
        ``(S, 3)`` and ``(S,)``.
    highlights_px
        ``(S, N, 2)`` position (x, y) of LED n mirrored in sphere s, NaN where it is not seen.
    lights, camera, noise
        As in the scene.
    electrons_per_us
        Signal of a white surface under irradiance 1.
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
    camera: CameraModel
    noise: NoiseModel
    electrons_per_us: float

    @property
    def depth_mm(self) -> Array:
        """``(H, W)`` distance from the camera along the optical axis, NaN outside the mask."""
        depth: Array = float(self.camera.working_distance_mm or 0.0) - self.height_mm
        return depth

    def save(self, folder: Path | str) -> tuple[Path, Path]:
        """Write ``truth.npz`` (maps and spheres) and ``truth.json`` (lights, camera, sensor).

        Parameters
        ----------
        folder
            Made where it is missing. Files of these names are replaced.

        Returns
        -------
        tuple of Path
            The two files.

        Raises
        ------
        StorageError
            If the disk refuses.
        """
        maps, values = Path(folder) / "truth.npz", Path(folder) / "truth.json"
        try:
            maps.parent.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(
                maps,
                normals=self.normals,
                height_mm=self.height_mm.astype(np.float32),
                albedo=self.albedo,
                mask=self.mask,
                sphere_masks=self.sphere_masks,
                sphere_centres_mm=self.sphere_centres_mm,
                sphere_radii_mm=self.sphere_radii_mm,
                highlights_px=self.highlights_px,
            )
            values.write_text(json.dumps(self._values(), indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise StorageError(f"{folder}: the truth cannot be written: {error}") from error
        return maps, values

    def _values(self) -> dict[str, Any]:
        lights = self.lights
        return {
            "lights": {
                "ids": list(lights.ids),
                "positions_mm": np.asarray(lights.positions_mm).tolist(),
                "axes": np.asarray(lights.axes).tolist(),
                "mu": np.asarray(lights.mu).tolist(),
                "intensities": np.asarray(lights.intensities).tolist(),
            },
            "camera": {
                "K": self.camera.K.tolist(),
                "width": self.camera.width,
                "height": self.camera.height,
                "working_distance_mm": self.camera.working_distance_mm,
            },
            "noise": asdict(self.noise),
            "electrons_per_us": self.electrons_per_us,
        }
