"""How a method fills the maps of photometric stereo."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from processing._stereo.estimator import ESTIMATORS
from processing._stereo.frames import Frames
from processing._stereo.light_model import LightModel
from processing._stereo.method import Method
from processing._stereo.noise_law import NoiseLaw
from processing._stereo.stereo_maps import StereoMaps
from processing._stereo.tile_least_squares import tile_least_squares
from rig import Progress, no_progress

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Number of pixels that are estimated together. Their samples approximately fit into the
# second-level cache, and the cost of starting the threads is small in comparison.
_BLOCK = 16384


def solve_maps(
    frames: Frames,
    model: LightModel,
    mask: Mask,
    law: NoiseLaw | Float | None,
    method: Method,
    maps: StereoMaps,
    camera: CameraModel | None,
    on_progress: Progress,
    first_row: int = 0,
) -> None:
    """Estimate the pixels of a mask and write their maps, which are 0 before.

    The law of the noise may be one for all pixels, ``(1, 2, N)``. ``first_row`` is the row of the
    image of the camera at which the frames begin.
    """
    if method == "ls" and law is None:
        # What is left are single pixels.
        pixels = tile_least_squares(frames, model, mask, maps, on_progress)
        on_progress = no_progress
    else:
        pixels = np.flatnonzero(mask)
    for first in range(0, len(pixels), _BLOCK):
        block = pixels[first : first + _BLOCK]
        samples, vectors = model.samples(frames, block)
        of_block = law.of(block, samples, vectors) if isinstance(law, NoiseLaw) else law
        view = None if camera is None else _toward_camera(camera, block, frames.width, first_row)
        scaled, rms = ESTIMATORS[method](samples, vectors, of_block, view)
        length = np.sqrt(np.einsum("pc,pc->p", scaled, scaled))
        with np.errstate(over="ignore"):
            strength = length.astype(np.float32)
        solved = strength > 0
        determined = block[solved]
        maps.normals.reshape(-1, 3)[determined] = scaled[solved] / length[solved, None]
        maps.albedo.flat[determined] = strength[solved]
        maps.residual.flat[determined] = rms[solved]
        maps.used.flat[block] = np.isfinite(samples).sum(axis=1)
        on_progress("normals", min(first + _BLOCK, len(pixels)), len(pixels))


def _toward_camera(
    camera: CameraModel, pixels: npt.NDArray[np.intp], width: int, first_row: int
) -> Float:
    """Return unit vectors ``(P, 3)`` from the surface at some pixels toward the camera."""
    rows, columns = np.divmod(pixels, width)
    rays = camera.rays(np.stack([columns, rows + first_row], axis=1))
    toward = -rays / np.sqrt(np.einsum("pc,pc->p", rays, rays))[:, None]
    return np.ascontiguousarray(toward, np.float32)
