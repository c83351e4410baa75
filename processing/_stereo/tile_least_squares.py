"""Least squares of many pixels at a time, each loop over pixels, for plain images."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from processing._stereo.frames import TILE, Flat, Frames, load_tile
from processing._stereo.light_model import LightModel
from processing._stereo.stereo_maps import StereoMaps
from processing._stereo.tile_kernels import (
    add_four_squares,
    add_one,
    add_products,
    add_scalar_product,
    add_six,
    add_square,
    add_two_products,
    difference,
    invert,
    irradiance,
    keep_measured,
    toward,
)
from rig import Progress

# Compiled in: processing/_stereo/frames.py ed9bdbecff92
# Compiled in: processing/_stereo/tile_kernels.py 1c123c374ef9

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Tiles that share buffers and a thread.
_TILES = 32
# Pixels between two reports of the progress.
_STEP = 1 << 20


def tile_least_squares(
    frames: Frames, model: LightModel, mask: Mask, maps: StereoMaps, on_progress: Progress
) -> npt.NDArray[np.intp]:
    """Solve ``value = vector . m`` by least squares and write the maps.

    Sums are float32. Where lights or samples differ between pixels, one step of refinement makes
    up for the rounding of the normal equations.

    Parameters
    ----------
    frames, model
        N images and lights.
    mask
        ``(H, W)``, the pixels to solve.
    maps
        Written inside the mask.
    on_progress
        Receives the stage ``normals``, in pixels of the images.

    Returns
    -------
    NDArray
        Indices of the pixels of the mask that were not solved, for the solver of single pixels:
        black, few samples, or values near the limits of float32.
    """
    left = np.zeros(mask.size, np.bool_)
    points, vectors, near = model.parameters()
    double = vectors.astype(np.float64)
    inverse = np.ascontiguousarray(np.linalg.pinv(double @ double.T) @ double, np.float32)
    for first in range(0, mask.size, _STEP):
        last = min(first + _STEP, mask.size)
        _solve(
            frames.flat, frames.image_step, frames.row_step, frames.width, frames.gain,
            frames.dark, frames.limit, points, vectors, inverse, *near, first, last,
            mask.reshape(-1), maps.normals.reshape(-1, 3), maps.albedo.reshape(-1),
            maps.residual.reshape(-1), maps.used.reshape(-1), left,
        )  # fmt: skip
        on_progress("normals", last, mask.size)
    return np.flatnonzero(left)


@numba.njit(cache=True)
def _shared_tile(tile: Float, vectors: Float, inverse: Float, found: Float) -> None:
    """Write x, y, z of the scaled normals and the sums of squared residuals, ``(4, TILE)``."""
    lights = len(tile)
    found[:] = 0
    six, four = lights // 6 * 6, lights // 4 * 4
    for a in range(3):
        for i in range(0, six, 6):
            add_six(
                found[a], tile[i], tile[i + 1], tile[i + 2], tile[i + 3], tile[i + 4], tile[i + 5],
                inverse[a, i : i + 6],
            )  # fmt: skip
        for i in range(six, lights):
            add_one(found[a], tile[i], inverse[a, i])
    for i in range(0, four, 4):
        add_four_squares(
            found[3], tile[i], tile[i + 1], tile[i + 2], tile[i + 3], found[0], found[1], found[2],
            vectors[:, i : i + 4],
        )  # fmt: skip
    for i in range(four, lights):
        add_square(found[3], tile[i], found[0], found[1], found[2], vectors[:, i])


@numba.njit(cache=True)
def _add_all_products(out: Float, a: Float, b: Float) -> None:
    """Add the products of two tiles over the lights."""
    lights = len(a)
    for i in range(0, lights - 1, 2):
        add_two_products(out, a[i], b[i], a[i + 1], b[i + 1])
    if lights % 2:
        add_products(out, a[-1], b[-1])


@numba.njit(cache=True)
def _solution(inverse: Float, moment: Float, out: Float) -> None:
    """Add the inverse matrices times vectors to the vectors ``out``, ``(3, TILE)``."""
    x, y, z = moment[0], moment[1], moment[2]
    add_scalar_product(out[0], inverse[0], inverse[1], inverse[2], x, y, z)
    add_scalar_product(out[1], inverse[1], inverse[3], inverse[4], x, y, z)
    add_scalar_product(out[2], inverse[2], inverse[4], inverse[5], x, y, z)


@numba.njit(cache=True)
def _own_tile(tile: Float, of: Float, matrix: Float, moment: Float, found: Float) -> None:
    """Write the same as `_shared_tile`, where each pixel has its own light vectors.

    ``of`` is ``(3, N, TILE)`` and 0 where there is no sample, as is ``tile``.
    """
    matrix[:], moment[:], found[:] = 0, 0, 0
    for a in range(3):
        _add_all_products(moment[a], of[a], tile)
        _add_all_products(matrix[a], of[0], of[a])
    _add_all_products(matrix[3], of[1], of[1])
    _add_all_products(matrix[4], of[1], of[2])
    _add_all_products(matrix[5], of[2], of[2])
    invert(matrix)
    _solution(matrix, moment, found)
    moment[:] = 0
    for i in range(len(tile)):
        residual = tile[i]
        difference(residual, residual, of[0, i], of[1, i], of[2, i], found[0], found[1], found[2])
        add_products(found[3], residual, residual)
        for a in range(3):
            add_products(moment[a], of[a, i], residual)
    _solution(matrix, moment, found)


@numba.njit(cache=True)
def _vectors_of_tile(
    tile: Float, vectors: Float, point: Float, near: bool,
    positions: Float, axes: Float, mu: Float, reference: Float,
    of: Float, gain: Float, count: Float,
) -> None:  # fmt: skip
    """Write the light vectors ``(3, N, TILE)`` and the number of samples; clear other samples."""
    count[:] = 0
    for i in range(len(tile)):
        if near:
            irradiance(
                gain, point[0], point[1], point[2], positions[i], axes[i], reference[i], mu[i]
            )
            for a in range(3):
                toward(of[a, i], point[a], positions[i, a], gain)
        else:
            gain[:] = 1
            for a in range(3):
                of[a, i] = vectors[a, i]
        keep_measured(tile[i], gain)
        count += gain
        for a in range(3):
            of[a, i] *= gain


@numba.njit(cache=True, error_model="numpy")
def _lengths(n: int, found: Float, count: Float, wanted: Mask, length: Float, per: Float) -> int:
    """Write lengths of normals, and reciprocals; return how many of n wanted pixels have none.

    The reciprocal is 0 where a pixel is not wanted, or where float32 does not hold its squares.
    """
    least, infinite, zero = np.float32(1e-24), np.float32(np.inf), np.float32(0)
    x, y, z, squares = found[0], found[1], found[2], found[3]
    for k in range(n):
        length2 = x[k] * x[k] + y[k] * y[k] + z[k] * z[k]
        # The comparisons are false for NaN.
        solved = wanted[k] and length2 > least and length2 < infinite and squares[k] < infinite
        length[k] = np.sqrt(length2) if solved else zero
    for k in range(n):
        squares[k] = np.sqrt(squares[k] / count[k])
    missing = 0
    for k in range(n):
        per[k] = np.float32(1) / length[k] if length[k] > zero else zero
        missing += int(wanted[k] and not length[k] > zero)
    return missing


@numba.njit(cache=True)
def _write(
    n: int, found: Float, count: Float, length: Float, per: Float, wanted: Mask,
    normals: Float, albedo: Float, residual: Float, used: npt.NDArray[np.uint16], left: Mask,
) -> None:  # fmt: skip
    """Write the maps of those of n pixels that are wanted and solved; the others are left."""
    for k in range(n):
        if per[k] > 0:
            normals[k, 0] = found[0, k] * per[k]
            normals[k, 1] = found[1, k] * per[k]
            normals[k, 2] = found[2, k] * per[k]
            albedo[k] = length[k]
            residual[k] = found[3, k]
            used[k] = np.uint16(count[k])
            left[k] = False
        elif wanted[k]:
            left[k] = True


@numba.njit(cache=True)
def _solve_block(
    flat: Flat, image_step: int, row_step: int, width: int, gain: Float, dark: Float,
    limit: np.float32, points: Double, vectors: Float, inverse: Float,
    positions: Float, axes: Float, mu: Float, reference: Float,
    first: int, last: int, mask: Mask,
    normals: Float, albedo: Float, residual: Float, used: npt.NDArray[np.uint16], left: Mask,
) -> None:  # fmt: skip
    """Solve the pixels from ``first`` to before ``last``."""
    lights = len(gain)
    near = len(points) > 0
    tile = np.zeros((lights, TILE), np.float32)
    of = np.zeros((3, lights, TILE), np.float32)
    matrix, moment = np.zeros((6, TILE), np.float32), np.zeros((3, TILE), np.float32)
    found, point = np.zeros((4, TILE), np.float32), np.zeros((3, TILE), np.float32)
    strength, own_count = np.zeros(TILE, np.float32), np.zeros(TILE, np.float32)
    length, per = np.zeros(TILE, np.float32), np.zeros(TILE, np.float32)
    count = np.full(TILE, np.float32(lights))
    for begin in range(first, last, TILE):
        n = min(TILE, last - begin)
        inside = mask[begin : begin + n]
        if not inside.any():
            continue
        maps = (
            normals[begin : begin + n], albedo[begin : begin + n], residual[begin : begin + n],
            used[begin : begin + n], left[begin : begin + n],
        )  # fmt: skip
        load_tile(flat, image_step, row_step, width, gain, dark, limit, begin, n, tile)
        if not near:
            _shared_tile(tile, vectors, inverse, found)
            missing = _lengths(n, found, count, inside, length, per)
            _write(n, found, count, length, per, inside, *maps)
            if not missing:
                continue
            inside = maps[4]
        else:
            for k in range(n):
                for a in range(3):
                    point[a, k] = points[begin + k, a]
        _vectors_of_tile(
            tile, vectors, point, near, positions, axes, mu, reference, of, strength, own_count
        )
        _own_tile(tile, of, matrix, moment, found)
        _lengths(n, found, own_count, inside, length, per)
        _write(n, found, own_count, length, per, inside, *maps)


@numba.njit(parallel=True, cache=True)
def _solve(
    flat: Flat, image_step: int, row_step: int, width: int, gain: Float, dark: Float,
    limit: np.float32, points: Double, vectors: Float, inverse: Float,
    positions: Float, axes: Float, mu: Float, reference: Float, first: int, last: int, mask: Mask,
    normals: Float, albedo: Float, residual: Float, used: npt.NDArray[np.uint16], left: Mask,
) -> None:  # fmt: skip
    size = _TILES * TILE
    for block in numba.prange((last - first + size - 1) // size):
        begin = first + size * block
        _solve_block(
            flat, image_step, row_step, width, gain, dark, limit, points, vectors, inverse,
            positions, axes, mu, reference, begin, min(begin + size, last), mask,
            normals, albedo, residual, used, left,
        )  # fmt: skip
