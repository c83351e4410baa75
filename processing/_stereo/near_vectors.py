"""Light vectors of near lights at the points of a block of pixels, compiled."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from processing._stereo.pixel_algebra import IN_PLACE, Double, Float

# Compiled in: processing/_stereo/pixel_algebra.py d36a51d0daee

_FAST = {"contract", "nsz"}


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=_FAST)
def _gains(near: Float, even: bool, px: float, py: float, pz: float, gain: Float) -> int:
    """Write the factors of vectors from a point to the LEDs, 0 if dark; return how many reach it.

    See `Lights` for the irradiance. ``near`` is that of `write_near_vectors`.
    """
    qx, qy, qz, ax, ay, az = near[0], near[1], near[2], near[3], near[4], near[5]
    mu, reference = near[6], near[7]
    x0, y0, z0 = np.float32(px), np.float32(py), np.float32(pz)
    zero, one = np.float32(0), np.float32(1)
    if not even:
        for i in range(len(gain)):
            x, y, z = qx[i] - x0, qy[i] - y0, qz[i] - z0
            cosine = -(x * ax[i] + y * ay[i] + z * az[i]) / np.sqrt(x * x + y * y + z * z)
            gain[i] = max(cosine, zero) ** (mu[i] - one)
    reached = np.int32(0)
    for i in range(len(gain)):
        x, y, z = qx[i] - x0, qy[i] - y0, qz[i] - z0
        per = one / np.sqrt(x * x + y * y + z * z)
        cosine = -(x * ax[i] + y * ay[i] + z * az[i]) * per
        full = reference[i] * per * per * per * cosine
        # The comparison is also false if the point is not finite.
        gain[i] = (full if even else full * gain[i]) if cosine > zero else zero
    for i in range(len(gain)):
        reached += np.int32(gain[i] > zero)
    return int(reached)


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=_FAST)
def _toward(q: Float, p: float, gain: Float, out: Float) -> None:
    """Write one component of light vectors."""
    own = np.float32(p)
    for i in range(len(out)):
        out[i] = (q[i] - own) * gain[i]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def write_near_vectors(
    first: int, last: int, points: Double, pixels: npt.NDArray[np.intp], near: Float, even: bool,
    values: Float, vectors: Float,
) -> None:  # fmt: skip
    """Write light vectors ``(P, 3, N)``; the sample of an LED that does not reach a point is NaN.

    Parameters
    ----------
    first, last
        The pixels to write, without the last one.
    points
        ``(M, 3)`` points of all pixels, mm.
    pixels
        ``(P,)`` indices into the points.
    near
        ``(8, N)`` positions, axes, exponents mu and ``r0^2 / cos(t0)^mu``.
    even
        Whether all mu are 1.
    values, vectors
        ``(P, N)`` samples and ``(P, 3, N)`` vectors, 0 where a light does not reach the point.
    """
    gain = np.zeros(values.shape[1], np.float32)
    for p in range(first, last):
        px, py, pz = points[pixels[p], 0], points[pixels[p], 1], points[pixels[p], 2]
        reached = _gains(near, even, px, py, pz, gain)
        _toward(near[0], px, gain, vectors[p, 0])
        _toward(near[1], py, gain, vectors[p, 1])
        _toward(near[2], pz, gain, vectors[p, 2])
        if reached < len(gain):
            for i in range(len(gain)):
                if not gain[i] > 0:
                    values[p, i] = np.nan
                    vectors[p, 0, i] = vectors[p, 1, i] = vectors[p, 2, i] = 0
