"""What the images alone show about their lights."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rig.arrays import Bool, Float64

_ROUNDS = 25
_PLAIN_ROUNDS = 8
# Of the places of lights along an axis, most lights differ from what the images show by less.
_UNEXPLAINED = 0.5


class Factors(NamedTuple):
    """Lights and normals that explain the images, up to one linear map of both.

    Parameters
    ----------
    lights
        ``(N, 3)``.
    normals
        ``(P, 3)``.
    deviation
        ``(P, N)`` samples minus the product of lights and normals; 0 where a sample is not usable.
        A pixel's samples have the root mean square 1.
    strengths
        Root mean square contributions of the three components to a sample, descending.
    """

    lights: Float64
    normals: Float64
    deviation: Float64
    strengths: Float64


def factorise(samples: Float64, usable: Bool) -> Factors:
    """Find lights and normals whose products are the samples of matte pixels.

    The images of a matte surface without shadows under N distant lights are linear combinations of
    three (Shashua, 1992); lights and normals follow from them up to a linear map (Hayakawa, 1994).
    Shadows are missing samples. Alternating least squares, reweighted by ``1 / (1 + (r / s)^2)``,
    gives highlights little influence.

    Parameters
    ----------
    samples
        ``(P, N)`` of P pixels, scaled so that the usable samples of a pixel have the root mean
        square 1.
    usable
        ``(P, N)`` bool, samples that are measured and not in shadow, at least 4 of each pixel.
    """
    weight = usable.astype(np.float64)
    samples = np.where(usable, samples, 0.0)
    count = usable.sum(axis=1)
    most = np.argsort(-count, kind="stable")[: max(len(count) // 3, 200)]
    lights = np.linalg.svd(samples[most], full_matrices=False)[2][:3].T
    for step in range(_ROUNDS):
        normals = solve(weight, samples, lights)
        lights = solve(weight.T, samples.T, normals)
        # Keep the factors orthonormal over the pixels, or they drift apart.
        _, spread, turn = np.linalg.svd(
            np.linalg.qr(normals, mode="r") @ lights.T / np.sqrt(len(normals))
        )
        turn, spread = turn[:3], spread[:3]
        lights = turn.T * spread
        normals = solve(weight, samples, lights)
        deviation = np.where(usable, samples - normals @ lights.T, 0.0)
        if step >= _PLAIN_ROUNDS:
            scale = max(1.4826 * float(np.median(np.abs(deviation[usable]))), 1e-6)
            weight = usable / (1 + (deviation / (2 * scale)) ** 2)
    return Factors(lights, normals, deviation, spread / np.sqrt(samples.shape[1]))


def solve(weight: Float64, samples: Float64, factors: Float64) -> Float64:
    """Return the weighted least squares solutions ``(P, 3)`` of ``samples = x @ factors.T``."""
    products = (factors[:, :, None] * factors[:, None, :]).reshape(-1, 9)
    normal = (weight @ products).reshape(-1, 3, 3)
    target = (weight * samples) @ factors
    ridge = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-12
    return np.asarray(np.linalg.solve(normal + ridge * np.eye(3), target[..., None])[..., 0])


def robust_solution(
    slopes: Float64, target: Float64, steps: int, half_weight: float
) -> tuple[Float64, Float64, Float64]:
    """Return the x of ``target = slopes @ x`` that explains most rows, by reweighted least squares.

    A residual of ``half_weight`` times the median has half of the weight. Returned are also the
    last weights, and the weighted products of the slopes from which the solution follows.
    """
    weight = np.ones(len(target))
    for _ in range(steps):
        rows = weight[:, None] * slopes
        products = rows.T @ slopes
        found = np.asarray(np.linalg.lstsq(products, rows.T @ target, rcond=None)[0])
        deviation = np.abs(target - slopes @ found)
        weight = 1 / (1 + (deviation / max(half_weight * float(np.median(deviation)), 1e-6)) ** 2)
    return found, weight, products


def align(found: Float64, given: Float64) -> Float64:
    """Map the lights that the images show to the given ones, by the linear map that fits most.

    The map follows from triples of lights, by the least median of the angles, and is refined by
    reweighted least squares over the lights that it fits.

    Parameters
    ----------
    found, given
        ``(N, 3)``.

    Returns
    -------
    Double
        ``(N, 3)`` the found lights in the frame and unit of the given ones.
    """
    count = len(found)
    rng = np.random.default_rng(0)
    triples = rng.permuted(np.tile(np.arange(count), (400, 1)), axis=1)[:, :3]
    volume = np.abs(np.linalg.det(found[triples])) * np.abs(np.linalg.det(given[triples]))
    triples = triples[volume > 0.05 * volume.max()]
    maps = np.linalg.solve(found[triples], given[triples])
    everything = np.linalg.lstsq(found, given, rcond=None)[0]
    maps = np.concatenate([maps, everything[None]])
    angles = _angles(found @ maps, given)
    # A map from three lights fits these exactly: judge it by the best two thirds of all.
    quantile = np.quantile(angles, 0.67, axis=1)
    best = int(np.argmin(quantile))
    mapped: Float64 = found @ maps[best]
    length = np.linalg.norm(given, axis=1)
    for _ in range(10):
        deviation = np.linalg.norm(mapped - given, axis=1) / length
        scale = max(float(np.quantile(deviation, 0.5)) * 1.5, 1e-4)
        root = (1 / (1 + (deviation / scale) ** 2) / length)[:, None] ** 0.5
        mapped = found @ np.linalg.lstsq(root * found, root * given, rcond=None)[0]
    return mapped


def explained(mapped: Float64, given: Float64) -> bool:
    """Return whether the images follow the lights along all three axes of their places.

    On a surface that is curved along one axis only (steps, a cylinder), a third component may come
    from pixels that are partly in shadow. It does not follow the lights along the other axis, and
    single lights cannot be judged.
    """
    axes = np.linalg.svd(given, full_matrices=False)[2].T
    off = np.median(np.abs((mapped - given) @ axes), axis=0)
    return bool(np.all(off < _UNEXPLAINED * np.median(np.abs(given @ axes), axis=0)))


def angles_deg(a: Float64, b: Float64) -> Float64:
    """Return the angles between vectors along the last axis."""
    return np.degrees(_angles(a, b))


def _angles(a: Float64, b: Float64) -> Float64:
    cosine = np.sum(a * b, axis=-1)
    one, other = np.broadcast_arrays(a, b)
    sine = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.asarray(np.arctan2(sine, cosine))
