"""What the images show above a matte surface."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from acquisition import DataError, Lights
from calibration import StackNoise
from calibration.radiance import check_linear, luma
from processing.stereo.frames import Frames
from processing.stereo.image_noise import NoiseLaw
from processing.stereo.light_model import LightModel
from processing.stereo.normals_and_albedo import PhotometricStereoResult
from processing.stereo.pixel_algebra import ANY_ORDER, IN_PLACE, law_or_alike
from rig import check_type, in_threads
from rig.arrays import Bool, Float32

# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

_BLOCK = 16384
# Where the noise is known, smaller residuals may be noise: 1 in 700 samples of a matte surface.
_SIGMAS = 3.0


def specular_residual(
    values: npt.ArrayLike,
    lights: Lights,
    stereo: PhotometricStereoResult,
    *,
    points_mm: npt.ArrayLike | None = None,
    noise: StackNoise | None = None,
) -> Float32:
    """Return the mean light that each pixel reflects above a matte surface.

    This is the mean over the measured samples of ``max(v - a max(l . n, 0), 0)`` with the albedo a
    and the normal n. Shadows do not reduce it. If the noise is known, samples within 3 standard
    deviations of the prediction count as 0; otherwise a matte surface has 0.4 standard deviations
    of the noise. It depends on the lights, and a broad lobe is in part explained by the albedo, so
    it is a lower limit of what the gloss adds. Saturated samples are not measured: use several
    exposures for glossy objects.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear radiance as in `photometric_stereo`, or ``(N, H, W, 3)``, of which the
        luma is used.
    lights
        The N lights.
    stereo
        Normals and gray albedo from these images.
    points_mm
        ``(H, W, 3)`` surface points for lights with positions, else None.
    noise
        Law of the noise of the values, `Stack.noise`; None if it is unknown.

    Returns
    -------
    NDArray
        ``(H, W)`` float32 in the unit of the albedo, at least 0; 0 outside the mask of the normals.

    Raises
    ------
    DataError
        If shapes or counts differ, or near lights have no points.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from processing import photometric_stereo
    >>> from processing.colour import specular_residual
    >>> lights = Lights(directions=[[0, 0, 1], [1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1]])
    >>> values = np.tile(lights.unit_directions[:, 2, None, None], (1, 2, 2))
    >>> stereo = photometric_stereo(values, lights, np.ones((2, 2), bool))
    >>> values[0, 0, 0] += 0.5  # a highlight in one of five images
    >>> print(specular_residual(values, lights, stereo).round(3))
    [[0.1 0. ]
     [0.  0. ]]
    """
    check_linear("values", values)
    check_type("lights", lights, Lights, "Lights(directions)")
    check_type("stereo", stereo, PhotometricStereoResult, "photometric_stereo(...) returns one")
    stack, mask = np.asarray(values, np.float32), stereo.normal_map.mask
    if stack.shape[:3] != (len(lights), *mask.shape) or stack.shape[3:] not in ((), (3,)):
        raise DataError(
            f"values of shape {stack.shape} do not fit {len(lights)} lights and normals of shape "
            f"{mask.shape}"
        )
    model = LightModel(lights, points_mm, mask)
    law = None if noise is None else NoiseLaw(noise, (len(lights), *mask.shape))
    return excess(stack, model, law, mask, stereo.normal_map.normals, stereo.albedo)


def excess(
    stack: Float32,
    model: LightModel,
    law: NoiseLaw | None,
    mask: Bool,
    normals: Float32,
    albedo: Float32,
) -> Float32:
    """Return `specular_residual` of the pixels of a mask."""
    lights = len(stack)
    scaled = (normals * albedo[..., None]).reshape(-1, 3)
    gray = Frames(stack) if stack.ndim == 3 else None
    residual = np.zeros(mask.size, np.float32)
    pixels = np.flatnonzero(mask)
    for first in range(0, len(pixels), _BLOCK):
        block = pixels[first : first + _BLOCK]
        if gray is None:
            seen = luma(stack.reshape(lights, mask.size, -1)[:, block])
            samples, vectors = np.ascontiguousarray(seen.T), model.vectors(block)
        else:
            samples, vectors = model.samples(gray, block)
        of_block = None if law is None else law.of(block, samples, vectors)
        residual[block] = mean_excess(samples, vectors, of_block, scaled[block])
    return residual.reshape(mask.shape)


def mean_excess(
    samples: Float32, vectors: Float32, law: Float32 | None, scaled: Float32
) -> Float32:
    """Return `specular_residual` of P pixels with scaled normals ``(P, 3)``; see `Estimator`.

    It is 0 for pixels without a normal.
    """
    of_noise, known = law_or_alike(law, samples.shape[1])
    means = np.zeros(len(samples), np.float32)
    in_threads(_above, len(samples), samples, vectors, of_noise, known, scaled, means)
    return means


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def _mean_excess(
    values: Float32, vectors: Float32, law: Float32, known: bool, scaled: Float32
) -> float:
    total, count = 0.0, np.int32(0)
    zero, sigmas = np.float32(0), np.float32(_SIGMAS if known else 0.0)
    nx, ny, nz = scaled[0], scaled[1], scaled[2]
    for i in range(len(values)):
        x, y, z = vectors[0, i], vectors[1, i], vectors[2, i]
        # The vector of a near light that does not reach the point is 0.
        measured = abs(values[i]) < np.float32(np.inf) and abs(x) + abs(y) + abs(z) > zero
        matte = max(x * nx + y * ny + z * nz, zero)
        excess = values[i] - matte
        counts = measured and excess > sigmas * np.sqrt(law[0, i] + law[1, i] * matte)
        total += float(excess if counts else zero)
        count += np.int32(measured)
    return total / float(max(int(count), 1))


@numba.njit(nogil=True, cache=True)
def _above(
    first: int, last: int, values: Float32, vectors: Float32, law: Float32, known: bool,
    scaled: Float32, mean: Float32,
) -> None:  # fmt: skip
    """Write the mean excess of each pixel; see `Estimator` for the parameters."""
    for p in range(first, last):
        if scaled[p, 0] == 0 and scaled[p, 1] == 0 and scaled[p, 2] == 0:
            continue
        mean[p] = _mean_excess(
            values[p], vectors[p if len(vectors) > 1 else 0], law[p if len(law) > 1 else 0],
            known, scaled[p],
        )  # fmt: skip
