"""How a method fills the maps of photometric stereo."""

from __future__ import annotations

import numpy as np

from acquisition import CameraModel, DataError
from processing.stereo.best import best
from processing.stereo.cauchy import cauchy
from processing.stereo.frames import Frames
from processing.stereo.image_noise import NoiseLaw
from processing.stereo.least_squares import least_squares
from processing.stereo.light_model import LightModel
from processing.stereo.method import Estimator, Method, given_estimator
from processing.stereo.stereo_maps import StereoMaps
from processing.stereo.tile_least_squares import tile_least_squares
from processing.stereo.trimmed import trimmed
from rig import Progress, no_progress
from rig.arrays import Bool, Float32, Float64, Intp

# Number of pixels that are estimated together. Their samples approximately fit into the
# second-level cache, and the cost of starting the threads is small in comparison.
_BLOCK = 16384


ESTIMATORS: dict[Method, Estimator] = {
    "ls": least_squares,
    "trimmed": trimmed,
    "cauchy": cauchy,
    "best": best,
}


def solve_maps(
    frames: Frames,
    model: LightModel,
    mask: Bool,
    law: NoiseLaw | Float32 | None,
    method: Method,
    maps: StereoMaps,
    camera: CameraModel | None,
    on_progress: Progress,
    rows: Intp | None = None,
) -> None:
    """Estimate the pixels of a mask and write their maps, which are 0 before.

    The law of the noise may be one for all pixels, ``(1, 2, N)``. ``rows`` are those of the image
    of the camera, if the frames are a part of it.
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
        view = None if camera is None else toward_camera(camera, block, frames.width, rows)
        write_solutions(block, samples, vectors, of_block, view, method, maps)
        on_progress("normals", min(first + _BLOCK, len(pixels)), len(pixels))


def write_solutions(
    pixels: Intp,
    samples: Float32,
    vectors: Float32,
    law: Float32 | None,
    view: Float32 | None,
    method: Method,
    maps: StereoMaps,
) -> None:
    """Estimate some pixels, indices into the flat maps, from their samples; see `Estimator`."""
    estimator = ESTIMATORS.get(method)
    if estimator is None:
        scaled, rms = given_solutions(method, samples, vectors, law, view)
    else:
        scaled, rms = estimator(samples, vectors, law, view)
    length = np.sqrt(np.einsum("pc,pc->p", scaled, scaled))
    with np.errstate(over="ignore"):
        strength = length.astype(np.float32)
    solved = strength > 0
    determined = pixels[solved]
    maps.normals.reshape(-1, 3)[determined] = scaled[solved] / length[solved, None]
    maps.albedo.reshape(-1)[determined] = strength[solved]
    maps.residual.reshape(-1)[determined] = rms[solved]
    maps.used.reshape(-1)[pixels] = np.isfinite(samples).sum(axis=1)


def given_solutions(
    name: str,
    samples: Float32,
    vectors: Float32,
    law: Float32 | None,
    view: Float32 | None,
) -> tuple[Float64, Float64]:
    """Return what an estimator of a user finds, after a check; see `Estimator`."""
    try:
        found = given_estimator(name)(samples, vectors, law, view)
    except Exception as error:
        raise DataError(f"the method {name} failed: {error!r}") from error
    if not isinstance(found, tuple) or len(found) != 2:
        raise DataError(f"the method {name} did not return a pair (scaled normals, residuals)")
    scaled, rms = (np.asarray(each, np.float64) for each in found)
    count = len(samples)
    if scaled.shape != (count, 3) or rms.shape != (count,):
        raise DataError(
            f"the method {name} returned arrays of shapes {scaled.shape} and {rms.shape} for "
            f"{count} pixels: expected ({count}, 3) and ({count},)"
        )
    # What is not finite does not determine a normal.
    unknown = ~(np.isfinite(scaled).all(axis=1) & np.isfinite(rms))
    return np.where(unknown[:, None], 0, scaled), np.where(unknown, 0, rms)


def toward_camera(
    camera: CameraModel,
    pixels: Intp,
    width: int,
    of_rows: Intp | None = None,
) -> Float32:
    """Return unit vectors ``(P, 3)`` from the surface at some pixels toward the camera.

    ``of_rows`` are the rows of the image of the camera, if the pixels are in a part of it.
    """
    rows, columns = np.divmod(pixels, width)
    if of_rows is not None:
        rows = of_rows[rows]
    rays = camera.rays(np.stack([columns, rows], axis=1))
    toward = -rays / np.sqrt(np.einsum("pc,pc->p", rays, rays))[:, None]
    return np.ascontiguousarray(toward, np.float32)
