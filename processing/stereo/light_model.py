"""Light vectors at surface points, and the samples of a block of pixels."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from acquisition import DataError, Lights
from calibration import EstimateError
from processing.stereo.frames import Frames
from processing.stereo.pixel_algebra import IN_PLACE, MAX_CONDITION
from rig import in_threads, pluralize
from rig.arrays import Bool, Float32, Float64, Intp

# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

_FAST = {"contract", "nsz"}


class LightModel:
    """The light vectors of N lights at the pixels of a mask.

    Parameters
    ----------
    lights
        Distant or near lights.
    points_mm
        ``(H, W, 3)`` surface points in the house frame, for lights with positions; None for
        distant lights.
    mask
        ``(H, W)`` bool, the pixels of the object.

    Raises
    ------
    DataError
        If near lights have no points, or the points do not fit the mask or are not finite in it.
    """

    def __init__(self, lights: Lights, points_mm: npt.ArrayLike | None, mask: Bool) -> None:
        self._lights = lights
        self._points: Float64 | None = None
        if not lights.near:
            return
        if points_mm is None:
            raise DataError(
                "lights with positions need surface points: give a camera with a working "
                "distance, or take the lights as distant"
            )
        points = np.ascontiguousarray(points_mm, np.float64)
        if points.shape != (*mask.shape, 3):
            raise DataError(
                f"points of shape {points.shape} do not fit a mask of shape {mask.shape}"
            )
        self._points = points.reshape(-1, 3)

    @property
    def intensities(self) -> Float64:
        """``(N,)`` mean intensities over the colours."""
        return np.asarray(np.mean(np.asarray(self._lights.intensities), axis=1), np.float64)

    def check(self, mask: Bool) -> None:
        """Refuse lights that leave a direction of the normal undetermined, by `EstimateError`."""
        _check_lights(self._typical_vectors(mask))

    def _typical_vectors(self, mask: Bool) -> Float64:
        """Return the ``(N, 3)`` light vectors in the middle of the object."""
        if self._points is None:
            return self._lights.vectors_at(np.zeros(3))
        pixels = np.flatnonzero(mask)
        some = self._points[pixels[:: 1 + len(pixels) // 1000]]
        finite = some[np.isfinite(some).all(axis=1)]
        if not len(finite):
            raise DataError("the surface points inside the mask are not finite: check the camera")
        return self._lights.vectors_at(np.median(finite, axis=0))

    def parameters(self) -> tuple[Float64, Float32, tuple[Float32, Float32, Float32, Float32]]:
        """Return what a kernel needs to compute light vectors.

        Returns
        -------
        points
            ``(H * W, 3)`` surface points; empty for distant lights.
        vectors
            ``(3, N)`` light vectors that all pixels share; those of the directions from the origin
            for near lights.
        near
            Positions, axes, exponents mu and ``r0^2 / cos(t0)^mu`` of near lights.
        """
        vectors = np.ascontiguousarray(self._lights.unit_directions.T, np.float32)
        if self._points is None:
            empty = np.zeros((0, 3), np.float32)
            return np.zeros((0, 3)), vectors, (empty, empty, empty[:, 0], empty[:, 0])
        near = _near_parameters(self._lights)
        positions, axes, mu, reference = (np.ascontiguousarray(x, np.float32) for x in near)
        return self._points, vectors, (positions, axes, mu, reference)

    def samples(self, frames: Frames, pixels: Intp) -> tuple[Float32, Float32]:
        """Return the input of an `Estimator`: the values of some pixels and their light vectors.

        Parameters
        ----------
        frames
            N images of linear radiance.
        pixels
            ``(P,)`` indices into the flat image.

        Returns
        -------
        values
            ``(P, N)`` float32, not finite if a sample was not measured or a light does not reach
            the point.
        vectors
            ``(1, 3, N)`` float32 for distant lights, which all pixels share; ``(P, 3, N)`` for near
            lights.
        """
        values = frames.of_pixels(pixels)
        return values, self._vectors(pixels, values)

    def vectors(self, pixels: Intp) -> Float32:
        """Return the light vectors of `samples`; 0 where a light does not reach the point."""
        return self._vectors(pixels, np.zeros((len(pixels), len(self._lights)), np.float32))

    def _vectors(self, pixels: Intp, values: Float32) -> Float32:
        if self._points is None:
            directions = self._lights.unit_directions.T[None]
            return np.ascontiguousarray(directions, np.float32)
        vectors = np.zeros((len(pixels), 3, len(self._lights)), np.float32)
        positions, axes, mu, reference = _near_parameters(self._lights)
        near = np.vstack([positions.T, axes.T, mu, reference]).astype(np.float32)
        even = bool(np.all(mu == 1))
        in_threads(
            _write_near_vectors, len(pixels), self._points, pixels, near, even, values, vectors
        )
        return vectors


def check_one_light_each(count: int, lights: Lights, noun: str = "image") -> None:
    """Refuse another number of images than of lights, by `DataError`."""
    if count != len(lights):
        raise DataError(
            f"{pluralize(count, noun)} for {pluralize(len(lights), 'light')}: give one light for "
            f"each {noun}"
        )


def _check_lights(vectors: Float64) -> None:
    """Reject lights that leave a direction of the normal undetermined."""
    if len(vectors) < 3:
        raise EstimateError(
            f"{pluralize(len(vectors), 'light does', 'lights do')} not determine a normal: at "
            "least 3 are required"
        )
    strength = np.linalg.svd(vectors, compute_uv=False)
    condition = strength[0] / max(strength[2], 1e-12 * strength[0], np.finfo(np.float64).tiny)
    if not condition <= MAX_CONDITION:
        raise EstimateError(
            f"the {len(vectors)} lights are too close to one plane to determine normals "
            f"(condition number {condition:.3g}, the maximum is {MAX_CONDITION:g}): "
            "add lights outside the plane"
        )


def _near_parameters(lights: Lights) -> tuple[Float64, Float64, Float64, Float64]:
    """Return positions, axes, mu and ``r0^2 / cos(t0)^mu``.

    The last factor normalises the irradiance at the origin to 1.
    """
    positions, axes, mu = (
        np.array(x, np.float64) for x in (lights.positions_mm, lights.axes, lights.mu)
    )
    distance = np.linalg.norm(positions, axis=1)
    cosine = -np.sum(positions * axes, axis=1) / distance
    reference: Float64 = distance**2 / cosine**mu
    return positions, axes, mu, reference


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=_FAST)
def _gains(near: Float32, even: bool, px: float, py: float, pz: float, gain: Float32) -> int:
    """Write the factors of vectors from a point to the LEDs, 0 if dark; return how many reach it.

    See `Lights` for the irradiance. ``near`` is that of `_write_near_vectors`.
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
def _toward(q: Float32, p: float, gain: Float32, out: Float32) -> None:
    """Write one component of light vectors."""
    own = np.float32(p)
    for i in range(len(out)):
        out[i] = (q[i] - own) * gain[i]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _write_near_vectors(
    first: int, last: int, points: Float64, pixels: Intp, near: Float32, even: bool,
    values: Float32, vectors: Float32,
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
