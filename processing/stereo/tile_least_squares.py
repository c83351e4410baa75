"""Least squares of many pixels at a time, each loop over pixels, for plain images."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np

from processing.stereo.frames import TILE, Flat, Frames, load_tile
from processing.stereo.light_model import LightModel
from processing.stereo.stereo_maps import StereoMaps
from processing.stereo.tile_kernels import (
    add_four_squares,
    add_one,
    add_products,
    add_scalar_product,
    add_six,
    add_square,
    add_two_products,
    clear,
    invert,
    irradiance,
    keep_measured,
    multiply,
    row,
    subtract_scalar_product,
    toward,
)
from rig import Progress
from rig.arrays import Bool, Float32, Float64, Intp, UInt16
from rig.kernels import INLINED, PART

# Compiled in: processing/stereo/frames.py f61390f77b18
# Compiled in: processing/stereo/tile_kernels.py 502b58c90a89
# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Pixels that share buffers and a thread.
_BLOCK = 32 * TILE
# Pixels between two reports of the progress.
_STEP = 1 << 20
# The sums of `_own_tile`: a normal matrix xx, xy, xz, yy, yz, zz, and the moments xv, yv, zv.
_FIRST = (0, 0, 0, 1, 1, 2, 0, 1, 2)
_SECOND = (0, 1, 2, 1, 2, 2, 3, 3, 3)
# Rows of the matrix as places of these sums.
_ROWS = ((0, 1, 2), (1, 3, 4), (2, 4, 5))


def tile_least_squares(
    frames: Frames, model: LightModel, mask: Bool, maps: StereoMaps, on_progress: Progress
) -> Intp:
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
    wanted, left = mask.reshape(-1), np.zeros(mask.size, np.bool_)
    points, vectors, near = model.parameters()
    double = vectors.astype(np.float64)
    inverse = np.ascontiguousarray(np.linalg.pinv(double @ double.T) @ double, np.float32)
    images = (
        frames.flat, frames.image_step, frames.row_step, frames.width, frames.gain, frames.dark,
        frames.limit, vectors,
    )  # fmt: skip
    normals, used = maps.normals.reshape(-1, 3), maps.used.reshape(-1)
    albedo, residual = maps.albedo.reshape(-1), maps.residual.reshape(-1)

    def solve(first: int) -> None:
        last = min(first + _BLOCK, mask.size)
        todo = wanted
        if not len(points):
            tile = np.zeros((len(frames), TILE), np.float32)
            samples = tile.reshape(-1)
            samples.flags.writeable = False
            missing = _solve_shared(
                *images, inverse, frames.in_place, tile, samples, first, last, wanted,
                normals, albedo, residual, used, left,
            )  # fmt: skip
            if not missing:
                return
            todo = left
        _solve_own(*images, points, *near, first, last, todo, normals, albedo, residual, used, left)

    # Threads, because a parallel kernel takes three times as long to compile.
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        for first in range(0, mask.size, _STEP):
            last = min(first + _STEP, mask.size)
            for _ in pool.map(solve, range(first, last, _BLOCK)):
                pass
            on_progress("normals", last, mask.size)
    return np.flatnonzero(left)


@numba.njit(**INLINED, error_model="numpy")
def _shared_tile(
    flat: Float32, first: int, step: int, vectors: Float32, inverse: Float32, found: Float32
) -> None:
    """Write x, y, z of the scaled normals and the sums of squared residuals, ``(4, TILE)``.

    The samples of the first light begin at ``first``, those of each other light ``step`` later.
    """
    lights = vectors.shape[1]
    six, four = lights // 6 * 6, lights // 4 * 4
    for a in range(4):
        clear(found[a])
    for i in range(0, six, 6):
        for a in range(3):
            add_six(found[a], flat, first + i * step, step, inverse[a, i : i + 6])
    for i in range(six, lights):
        for a in range(3):
            add_one(found[a], row(flat, first + i * step), inverse[a, i])
    x, y, z, squares = found[0], found[1], found[2], found[3]
    for i in range(0, four, 4):
        of = vectors[:, i : i + 4]
        add_four_squares(squares, flat, first + i * step, step, x, y, z, of)
    for i in range(four, lights):
        add_square(squares, row(flat, first + i * step), x, y, z, vectors[:, i])


@numba.njit(**INLINED, error_model="numpy")
def _own_tile(of: Float32, sums: Float32, found: Float32) -> None:
    """Write the same as `_shared_tile`, where each pixel has its own light vectors.

    ``of`` is ``(4, N, TILE)``: light vectors and samples, 0 where there is no sample. The samples
    are replaced by residuals. ``sums`` is ``(9, TILE)``: normal matrix and moments.
    """
    lights = of.shape[1]
    for a in range(4):
        clear(found[a])
    for step in range(2):
        for s in range(6 * step, 9):
            out, a, b = sums[s], of[_FIRST[s]], of[_SECOND[s]]
            clear(out)
            for i in range(0, lights - 1, 2):
                add_two_products(out, a[i], b[i], a[i + 1], b[i + 1])
            if lights % 2:
                add_products(out, a[lights - 1], b[lights - 1])
        if step == 0:
            invert(sums)
        for a in range(3):
            x, y, z = _ROWS[a]
            add_scalar_product(found[a], sums[x], sums[y], sums[z], sums[6], sums[7], sums[8])
        for i in range(lights if step == 0 else 0):
            subtract_scalar_product(
                of[3, i], of[0, i], of[1, i], of[2, i], found[0], found[1], found[2]
            )
            add_products(found[3], of[3, i], of[3, i])


@numba.njit(**INLINED, error_model="numpy")
def _vectors_of_tile(
    vectors: Float32, point: Float32, positions: Float32, axes: Float32, mu: Float32,
    reference: Float32, of: Float32, gain: Float32, count: Float32,
) -> None:  # fmt: skip
    """Write the light vectors and the number of samples; clear other samples, see `_own_tile`."""
    clear(count)
    for i in range(of.shape[1]):
        if len(positions):
            irradiance(
                gain, point[0], point[1], point[2], positions[i], axes[i], reference[i], mu[i]
            )
            for a in range(3):
                toward(of[a, i], point[a], positions[i, a], gain)
        else:
            for k in range(TILE):
                gain[k] = 1
                for a in range(3):
                    of[a, i, k] = vectors[a, i]
        keep_measured(of[3, i], gain)
        add_one(count, gain, np.float32(1))
        for a in range(3):
            multiply(of[a, i], gain)


@numba.njit(**PART, error_model="numpy")
def _write(
    n: int, found: Float32, count: Float32, length: Float32, per: Float32, wanted: Bool,
    normals: Float32, albedo: Float32, residual: Float32, used: UInt16, left: Bool,
) -> int:  # fmt: skip
    """Write the maps of n pixels that are wanted; return how many are left without a solution.

    These are pixels of which float32 does not hold the squares.
    """
    least, infinite, zero = np.float32(1e-24), np.float32(np.inf), np.float32(0)
    x, y, z, squares = found[0], found[1], found[2], found[3]
    for k in range(TILE):
        length2 = x[k] * x[k] + y[k] * y[k] + z[k] * z[k]
        # The comparisons are false for NaN.
        solved = length2 > least and length2 < infinite and squares[k] < infinite
        length[k] = np.sqrt(length2) if solved else zero
    for k in range(TILE):
        squares[k] = np.sqrt(squares[k] / count[k])
    for k in range(TILE):
        per[k] = np.float32(1) / length[k]
    missing = 0
    for k in range(n):
        if wanted[k]:
            left[k] = not length[k] > zero
            if left[k]:
                missing += 1
                continue
            normals[k, 0], normals[k, 1], normals[k, 2] = (
                x[k] * per[k],
                y[k] * per[k],
                z[k] * per[k],
            )
            albedo[k] = length[k]
            residual[k] = squares[k]
            used[k] = np.uint16(count[k])
    return missing


@numba.njit(**PART, error_model="numpy")
def _any(wanted: Bool, first: int, last: int) -> bool:
    found = False
    for k in range(first, last):
        found |= wanted[k]
    return found


@numba.njit(cache=True, nogil=True)
def _solve_shared(
    flat: Flat, image_step: int, row_step: int, width: int, gain: Float32, dark: Float32,
    limit: np.float32, vectors: Float32, inverse: Float32, in_place: bool, tile: Float32,
    samples: Float32, first: int, last: int, mask: Bool,
    normals: Float32, albedo: Float32, residual: Float32, used: UInt16, left: Bool,
) -> int:  # fmt: skip
    """Solve the pixels from ``first`` to before ``last`` from all samples; return those left.

    Samples that need no conversion are read where they are, ``in_place``, others from ``tile``, of
    which ``samples`` is a flat view of the type of the images.
    """
    found, count = np.zeros((4, TILE), np.float32), np.zeros(TILE, np.float32)
    length, per = np.zeros(TILE, np.float32), np.zeros(TILE, np.float32)
    for k in range(TILE):
        count[k] = len(gain)
    missing = 0
    for begin in range(first, last, TILE):
        n = min(TILE, last - begin)
        if _any(mask, begin, begin + n):
            of, start, step = flat[2], begin, image_step
            if n < TILE or not in_place:
                load_tile(flat, image_step, row_step, width, gain, dark, limit, begin, n, tile)
                of, start, step = samples, 0, TILE
            _shared_tile(of, start, step, vectors, inverse, found)
            end = begin + n
            missing += _write(
                n, found, count, length, per, mask[begin:end], normals[begin:end],
                albedo[begin:end], residual[begin:end], used[begin:end], left[begin:end],
            )  # fmt: skip
    return missing


@numba.njit(cache=True, nogil=True)
def _solve_own(
    flat: Flat, image_step: int, row_step: int, width: int, gain: Float32, dark: Float32,
    limit: np.float32, vectors: Float32, points: Float64,
    positions: Float32, axes: Float32, mu: Float32, reference: Float32, first: int, last: int,
    mask: Bool, normals: Float32, albedo: Float32, residual: Float32, used: UInt16, left: Bool,
) -> None:  # fmt: skip
    """Solve the pixels from their measured samples; the mask may be the array of those left."""
    of = np.zeros((4, len(gain), TILE), np.float32)
    sums, point = np.zeros((9, TILE), np.float32), np.zeros((3, TILE), np.float32)
    found, strength = np.zeros((4, TILE), np.float32), np.zeros(TILE, np.float32)
    length, per = np.zeros(TILE, np.float32), np.zeros(TILE, np.float32)
    count = np.zeros(TILE, np.float32)
    for begin in range(first, last, TILE):
        n = min(TILE, last - begin)
        if not _any(mask, begin, begin + n):
            continue
        load_tile(flat, image_step, row_step, width, gain, dark, limit, begin, n, of[3])
        for k in range(n if len(points) else 0):
            for a in range(3):
                point[a, k] = points[begin + k, a]
        _vectors_of_tile(vectors, point, positions, axes, mu, reference, of, strength, count)
        _own_tile(of, sums, found)
        end = begin + n
        _write(
            n, found, count, length, per, mask[begin:end], normals[begin:end],
            albedo[begin:end], residual[begin:end], used[begin:end], left[begin:end],
        )  # fmt: skip
