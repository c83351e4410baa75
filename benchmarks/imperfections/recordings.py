"""Recordings whose true shape is known, simulated or real, as linear images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import cv2
import numpy as np
import tomli_w

from acquisition import (
    CameraModel,
    Lights,
    read_source,
    write_mask,
    write_png,
)
from acquisition.pixels import write_tiff
from benchmarks.imperfections.remedies import Remedy
from processing import Reconstruction, reconstruct
from rig.arrays import Bool, Float32, Float64
from simulator import Scene, read_scene, render
from simulator.camera import sensor_image
from simulator.shapes import Even

Form = Literal["png16", "png8", "tif16", "jpg"]

# The brightest thousandth of the samples is at this share of white.
BRIGHTEST = 0.9
# The same on the sensor, so that only highlights are saturated.
_EXPOSED = 0.7
# Quality of JPEG.
_QUALITY = 92
# Heights of a flat object, as a share of its width.
_FLAT = 0.1
NAN = float("nan")


@dataclass(frozen=True, eq=False)
class Recording:
    """Images of an object, with what a user knows and with the truth.

    Parameters
    ----------
    name
        Name of the scene.
    images
        ``(N, H, W)`` or ``(N, H, W, 3)`` float32, 1 is white.
    lights, camera, mask
        What the user has; no camera if it is not known.
    normals
        ``(H, W, 3)`` true normals; None if they are not known.
    height_mm
        ``(H, W)`` true heights; None if they are not known.
    form
        How the images are written.
    uniform
        Whether the albedo is the same everywhere.
    """

    name: str
    images: Float32
    lights: Lights
    camera: CameraModel | None
    mask: Bool
    normals: Float32 | None
    height_mm: Float64 | None
    form: Form = "png16"
    uniform: bool = False

    @property
    def flat(self) -> bool:
        """Whether the heights range over less than a tenth of the width of the object."""
        if self.height_mm is None:
            return False
        inside = self.mask.any(axis=0)
        across_mm = self._pixel_mm * np.count_nonzero(inside)
        return bool(np.ptp(self.height_mm[self.mask]) < _FLAT * across_mm)

    @property
    def _pixel_mm(self) -> float:
        if self.camera is None:
            return NAN
        return float(self.camera.centre_mm[2] / self.camera.focal_px)

    def take(self, indices: Sequence[int]) -> Recording:
        """Return the recording under some of its lights."""
        which = list(indices)
        return replace(self, images=self.images[which], lights=self.lights.take(which))

    def write(self, folder: Path) -> None:
        """Write the images into a new folder, named after their lights, and the mask next to it."""
        folder.mkdir(parents=True)
        for name, image in zip(self.lights.ids, self.images, strict=True):
            deep = np.rint(np.clip(image, 0, 1) * 65535).astype(np.uint16)
            flat = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
            if self.form == "png16":
                write_png(folder / f"{name}.png", deep)
            elif self.form == "png8":
                write_png(folder / f"{name}.png", flat)
            elif self.form == "tif16":
                write_tiff(folder / f"{name}.tif", deep)
            else:
                bgr = flat[..., ::-1] if flat.ndim == 3 else flat
                path = str(folder / f"{name}.jpg")
                cv2.imwrite(path, bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        write_mask(mask_file(folder), self.mask)

    def reconstructed(self, folder: Path, remedy: Remedy | None = None) -> Reconstruction:
        """Write the recording into a new folder and reconstruct it as a user does."""
        self.write(folder)
        remedy = remedy or Remedy()
        source = read_source(
            folder,
            lights=self.lights,
            mask_path=mask_file(folder),
            camera=self.camera,
            transfer=remedy.transfer,
            without=remedy.without,
        )
        # The causes are those of the images as they are.
        return reconstruct(source, align="off", **remedy.keywords)


def mask_file(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.mask.png")


def photographed(name: str, scene: Scene, seed: int) -> Recording:
    """Render a scene and record it with the noise of its sensor; ambient light is subtracted."""
    made = render(scene)
    truth, sensor = made.truth, scene.noise
    white = (sensor.converter_end_dn - sensor.black_level_dn) * sensor.electrons_per_dn
    exposure_us = _EXPOSED * white / float(np.percentile(made.planes, 99.9))
    frames = np.stack(
        [
            sensor_image((plane + made.ambient) * exposure_us, sensor, key=(seed, shot))
            for shot, plane in enumerate(made.planes)
        ]
    )
    cfa = getattr(scene.lens, "cfa", None)
    if cfa is None:
        dark = sensor.black_level_dn + made.ambient * exposure_us / sensor.electrons_per_dn
        images = frames.astype(np.float32) - dark.astype(np.float32)
    else:  # the black level stays while colours are interpolated, so that no sample is negative
        code = {"RGGB": cv2.COLOR_BayerRGGB2RGB}[cfa]
        images = np.stack([cv2.cvtColor(frame, code) for frame in frames]).astype(np.float32)
        images -= np.float32(sensor.black_level_dn)
    images *= np.float32(BRIGHTEST / np.percentile(images, 99.9))
    return Recording(
        name,
        images,
        truth.lights,
        truth.camera,
        truth.mask,
        truth.normals,
        truth.height_mm,
        uniform=isinstance(scene.pattern, Even),
    )


def built(name: str, table: dict[str, Any], seed: int, size: tuple[int, int]) -> Recording:
    """Record the scene of a scene file with its values given as a table."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.toml"
        path.write_text(tomli_w.dumps(table), encoding="utf-8")
        scene = read_scene(path, size=size, seed=seed)
    return photographed(name, scene, seed)
