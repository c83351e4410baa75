"""Fit of the shifts of images under different lights, with the surface eliminated.

Of a matte surface, image k shows b(x + s_k) . l_k(x), with the scaled normal b of each pixel, its
light vector l_k and the shift s_k. Smooth deviations from this model (near lights, room light,
gloss) are removed by a high-pass filter, which commutes with the sum as far as the light vectors
change slowly. b is eliminated from the normal equations of all shifts, so that no image is the
reference. Shadows and highlights have low weights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numba
import numpy as np
from scipy import sparse

from calibration import EstimateError
from calibration.radiance import Shift
from rig.arrays import Bool, Float32, Float64, Intp

# Structure wider than this many pixels is removed.
SMOOTH_PX: Final = 3.0
# Pixels beyond a patch that filter and interpolation need.
MARGIN: Final = 14
# Darker samples, relative to the brightest of their pixel, are probably in shadow.
_DARK: Final = 0.1
_TUNING: Final = 2.0
# Samples of all images, if no more pixels are asked for; with more images, fewer are enough.
_MOST_SAMPLES: Final = 144_000
_FIRST_SAMPLES: Final = 48_000
# Prior of shifts in pixels of the full images, and of relative strengths.
_PRIOR_PX: Final = 40.0
_PRIOR_GAIN: Final = 0.3
_SETTLED_PX: Final = 0.003
# Lights by which a pixel must be lit to show a shift, and the fewest such pixels.
_FEWEST_LIT: Final = 3
_FEWEST_PIXELS: Final = 50
_MOST_DAMPING: Final = 1e3
_RIDGE: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Patches:
    """Parts of all images.

    Parameters
    ----------
    values
        ``(N, T, h, w)`` linear radiance, NaN where missing.
    inside
        ``(T, h, w)`` bool: pixels that count; others serve filter and interpolation.
    vectors
        Return light vectors ``(P, N, 3)`` of pixels by their flat indices into ``inside``.
    size
        Pixels of the full images along a side of a pixel.
    beside_shadows
        Distance from shadows in pixels within which samples do not count, since the filter mixes
        them with the shadow.
    """

    values: Float32
    inside: Bool
    vectors: Callable[[Intp], Float64]
    size: int
    beside_shadows: int = 0


@dataclass(frozen=True, eq=False)
class ShiftFit:
    """Fitted shifts.

    Parameters
    ----------
    shifts
        ``(N, 2)`` right and down, pixels of the patches; their mean is 0.
    covariance
        ``(2 N, 2 N)`` from the scatter between parts of the object.
    explained
        Share of the fine structure that the model explains.
    contrast
        Fine structure relative to the light.
    state
        The problem at these shifts.
    """

    shifts: Float64
    covariance: Float64
    explained: float
    contrast: float
    state: _State

    def gain(self, unmoved: Patches) -> float:
        """Return the share by which the cost is lower than that of images as they are."""
        state = self.state
        vectors, still = unmoved.vectors(state.pixels), np.zeros_like(self.shifts)
        before = _at(unmoved, state.pixels, vectors, still, state.scale)
        return 1 - state.cost / max(before.cost, 1e-300)


def fit_shifts(patches: Patches, starts: Sequence[Float64], steps: int, least: int = 0) -> ShiftFit:
    """Fit the shifts by damped Gauss-Newton steps, from the best of several starts.

    Parameters
    ----------
    patches
        Parts of the images.
    starts
        First shifts ``(N, 2)``, right and down, in pixels of the patches.
    steps
        Largest number of steps from each.
    least
        Fewest pixels that count, if there are so many, also of many images.
    """
    _, fine = _filtered(patches, np.zeros((len(patches.values), 2)))
    pixels = _strongest(patches, fine, max(_MOST_SAMPLES // len(patches.values), least))
    vectors = np.ascontiguousarray(patches.vectors(pixels))
    fits = []
    scale = None
    for start in starts:
        shifts, damping = start - start.mean(axis=0), 1e-3
        state = _linearized(_at(patches, pixels, vectors, shifts, scale))
        scale = state.scale
        for _ in range(steps):
            change = _step(state, damping)
            new = _at(patches, pixels, vectors, shifts + change, scale)
            if new.cost <= state.cost:
                shifts, state, damping = shifts + change, _linearized(new), max(damping / 5, 1e-6)
                if np.abs(change).max() < _SETTLED_PX:
                    break
            else:
                damping *= 10
                if damping > _MOST_DAMPING:
                    break
        fits.append((state.cost, shifts, state))
    _, shifts, state = min(fits, key=lambda fit: fit[0])
    return ShiftFit(shifts, _covariance(state), state.explained, state.contrast, state)


class FirstLook(NamedTuple):
    """A single step from no shifts, ``(N, 2)``, and the share by which it lowers the cost."""

    step: Float64
    gain: float


def first_look(patches: Patches) -> FirstLook:
    """Return what a single step from no shifts gives, or half of it if that is better."""
    still = np.zeros((len(patches.values), 2))
    filtered = _filtered(patches, still)
    pixels = _strongest(patches, filtered[1], _FIRST_SAMPLES // len(patches.values))
    vectors = np.ascontiguousarray(patches.vectors(pixels))
    state = _linearized(_at(patches, pixels, vectors, still, None, filtered))
    step = _step(state, 0.0)
    costs = [_at(patches, pixels, vectors, share * step, state.scale).cost for share in (1, 0.5)]
    return FirstLook(step, 1 - min(costs) / max(state.cost, 1e-300))


@dataclass(frozen=True, eq=False)
class _State:
    """The linearized problem: normal equations of three parameters for each image."""

    pixels: Intp
    hessian: Float64
    gradient: Float64
    of_tiles: Float64
    scale: Float64
    cost: float
    explained: float
    contrast: float


def _filtered(patches: Patches, shifts: Float64) -> tuple[Float32, Float32]:
    """Return the samples moved back by the shifts, and the same without smooth structure."""
    moved = np.empty_like(patches.values)
    fine = np.empty_like(moved)
    for k, (right, down) in enumerate(shifts.tolist()):
        for tile, image in enumerate(patches.values[k]):
            part = Shift(right, down).moved(image, 0, slice(0, len(image)))
            known = np.isfinite(part)
            weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), SMOOTH_PX)
            filled = np.where(known, part, np.float32(0))
            smooth = cv2.GaussianBlur(filled, (0, 0), SMOOTH_PX) / np.maximum(weight, 1e-3)
            moved[k, tile], fine[k, tile] = part, np.where(known, part - smooth, np.float32(0))
    return moved, fine


def _lit(moved: Float32, beside: int) -> Bool:
    """Return the samples that are lit, and not next to a shadow, whose edge is no structure."""
    known = np.isfinite(moved)
    light = np.where(known, moved, np.float32(0))
    dark = known & (light < _DARK * light.max(axis=0))
    near = np.ones((2 * beside + 1, 2 * beside + 1), np.uint8)
    wide = [[cv2.dilate(tile.astype(np.uint8), near) for tile in image] for image in dark]
    return np.asarray(known & (np.array(wide) == 0))


def _slopes(fine: Float32) -> tuple[Float32, Float32]:
    """Return the slopes right and down of patches ``(N, T, h, w)``, by central differences."""
    right, down = np.zeros_like(fine), np.zeros_like(fine)
    right[..., 1:-1] = (fine[..., 2:] - fine[..., :-2]) / 2
    down[..., 1:-1, :] = (fine[..., 2:, :] - fine[..., :-2, :]) / 2
    return right, down


def _strongest(patches: Patches, fine: Float32, most: int) -> Intp:
    """Return the flat indices of the pixels with most fine structure."""
    energy = np.zeros(patches.inside.shape)
    for image in fine:
        right, down = _slopes(image)
        energy += right.astype(np.float64) ** 2 + down.astype(np.float64) ** 2
    energy[~patches.inside] = -1
    count = min(most, int(patches.inside.sum()))
    return np.sort(np.argpartition(energy.ravel(), -count)[-count:])


def _at(
    patches: Patches,
    pixels: Intp,
    vectors: Float64,
    shifts: Float64,
    scale: Float64 | None,
    filtered: tuple[Float32, Float32] | None = None,
) -> _Aligned:
    """Return the images moved back by some shifts, and the surface that fits them.

    ``scale`` ``(P, 1)`` are the standard deviations of the residuals of the pixels; computed if it
    is None. ``filtered`` is what `_filtered` returns for the shifts.
    """
    moved, fine = filtered or _filtered(patches, shifts)
    count = len(moved)
    # A kernel is compiled for each layout of its arguments.
    seen = np.ascontiguousarray(fine.reshape(count, -1)[:, pixels].T, np.float64)
    lit = _lit(moved, patches.beside_shadows).reshape(count, -1)
    usable = np.ascontiguousarray(lit[:, pixels].T)
    if np.count_nonzero(usable.sum(axis=1) > _FEWEST_LIT) < _FEWEST_PIXELS:
        raise EstimateError("too few pixels of the object are lit by enough lights to align images")
    surface = _surface(vectors, seen, usable, scale)
    ratio = surface.residuals / (_TUNING * surface.scale)
    # A missing sample counts as a usual residual: shifts out of the image gain nothing.
    ratio = np.where(usable, ratio, 1 / _TUNING)
    cost = float((_TUNING**2 / 2 * np.log1p(ratio**2)).sum())
    offsets = np.concatenate([shifts, np.zeros((count, 1))], axis=1).reshape(-1)
    pulled = _priors(count, patches.size) * offsets
    cost += float((pulled * offsets).sum()) / 2
    return _Aligned(patches, pixels, moved, fine, seen, usable, surface, pulled, cost)


def _linearized(aligned: _Aligned) -> _State:
    """Return the normal equations at the shifts of images."""
    patches, pixels, moved, fine, seen, usable, surface, pulled, cost = aligned
    count, vectors, weights, residuals = len(moved), *surface[:3]
    slopes = [one.reshape(count, -1)[:, pixels].T.astype(np.float64) for one in _slopes(fine)]
    across, along, itself = (
        (vectors @ surface.solved(values)[..., None])[..., 0] for values in (*slopes, seen)
    )
    # Of the aligned samples by shifts of their image and by its strength.
    columns = np.stack([-across, -along, itself], axis=2)
    weighted = weights[..., None] * vectors
    factor = np.linalg.cholesky(surface.inverse)
    # What the surface follows, (P, 3, 3 N).
    size = 3 * count
    followed = (columns[..., None] * weighted[:, :, None, :]).reshape(len(pixels), size, 3) @ factor
    flat = followed.transpose(0, 2, 1).reshape(-1, size)
    hessian = -(flat.T @ flat)
    own = (weights[..., None] * columns).transpose(1, 2, 0) @ columns.transpose(1, 0, 2)
    for k in range(count):
        hessian[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += own[k]
    scores = (columns * (weights * residuals)[..., None]).reshape(len(pixels), size)
    tiles = _tiles(pixels, patches.inside.shape)
    members = sparse.csr_array((np.ones(len(tiles)), (tiles, np.arange(len(tiles)))))
    of_tiles = np.asarray(members @ scores)
    gradient = scores.sum(axis=0) - pulled
    left = np.median(np.abs(residuals[usable])) / max(float(np.median(np.abs(seen[usable]))), 1e-12)
    explained = 1 - float(left)
    light = moved.reshape(count, -1)[:, pixels].T[usable]
    contrast = float(np.median(np.abs(seen[usable])) / max(float(np.median(light)), 1e-12))
    hessian += np.diag(_priors(count, patches.size))
    return _State(pixels, hessian, gradient, of_tiles, surface.scale, cost, explained, contrast)


class _Surface(NamedTuple):
    """A robust fit of scaled normals: weights are reciprocal variances, the inverse covariances."""

    vectors: Float64
    weights: Float64
    residuals: Float64
    scale: Float64
    inverse: Float64

    def solved(self, values: Float64) -> Float64:
        """Return the fit of other values with the same weights."""
        weighted = self.weights[..., None] * self.vectors
        right = weighted.transpose(0, 2, 1) @ values[..., None]
        return np.asarray((self.inverse @ right)[..., 0])


class _Aligned(NamedTuple):
    """Images moved back by shifts, as samples ``(P, N)`` of pixels, and the surface they show."""

    patches: Patches
    pixels: Intp
    moved: Float32
    fine: Float32
    seen: Float64
    usable: Bool
    surface: _Surface
    pulled: Float64
    cost: float


def _surface(vectors: Float64, seen: Float64, usable: Bool, scale: Float64 | None) -> _Surface:
    weights = usable.astype(np.float64)
    for _ in range(3):
        residuals, _ = _fitted(vectors, weights, seen)
        if scale is None:
            spread = 1.4826 * float(np.median(np.abs(residuals[usable])))
            own = 1.4826 * np.median(np.abs(residuals), axis=1, keepdims=True)
            found = np.maximum(own, max(spread, 1e-12))
        else:
            found = scale
        weights = usable / (1 + (residuals / (_TUNING * found)) ** 2) / found**2
    _, inverse = _fitted(vectors, weights, seen)
    return _Surface(vectors, weights, residuals, found, inverse)


@numba.njit(nogil=True, cache=True)
def _fitted(vectors: Float64, weights: Float64, seen: Float64) -> tuple[Float64, Float64]:
    """Return the residuals of fits of scaled normals, and the covariances of these.

    Covariances ``(P, 3, 3)`` are large where light is missing.
    """
    residuals = np.zeros_like(seen)
    inverse = np.zeros((len(seen), 3, 3))
    for p in range(len(seen)):
        xx = xy = xz = yy = yz = zz = x = y = z = 0.0
        for k in range(seen.shape[1]):
            weight = weights[p, k]
            u, v, w = vectors[p, k, 0], vectors[p, k, 1], vectors[p, k, 2]
            xx, xy, xz = xx + weight * u * u, xy + weight * u * v, xz + weight * u * w
            yy, yz, zz = yy + weight * v * v, yz + weight * v * w, zz + weight * w * w
            value = weight * seen[p, k]
            x, y, z = x + value * u, y + value * v, z + value * w
        ridge = _RIDGE * max(xx + yy + zz, _RIDGE)
        xx, yy, zz = xx + ridge, yy + ridge, zz + ridge
        # By cofactors, which keep it symmetric.
        own = inverse[p]
        own[0, 0], own[1, 1], own[2, 2] = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
        own[0, 1] = own[1, 0] = xz * yz - xy * zz
        own[0, 2] = own[2, 0] = xy * yz - xz * yy
        own[1, 2] = own[2, 1] = xy * xz - xx * yz
        own /= xx * own[0, 0] + xy * own[0, 1] + xz * own[0, 2]
        a = own[0, 0] * x + own[0, 1] * y + own[0, 2] * z
        b = own[1, 0] * x + own[1, 1] * y + own[1, 2] * z
        c = own[2, 0] * x + own[2, 1] * y + own[2, 2] * z
        for k in range(seen.shape[1]):
            u, v, w = vectors[p, k, 0], vectors[p, k, 1], vectors[p, k, 2]
            residuals[p, k] = seen[p, k] - (a * u + b * v + c * w)
    return residuals, inverse


def _tiles(pixels: Intp, shape: tuple[int, ...]) -> Intp:
    """Return the part of the object of each pixel: its patch, or one of 36 parts of one patch."""
    tile, rest = np.divmod(pixels, shape[1] * shape[2])
    if shape[0] > 1:
        return tile
    rows, columns = np.divmod(rest, shape[2])
    return np.asarray((rows * 6 // shape[1]) * 6 + columns * 6 // shape[2])


def _priors(count: int, size: int) -> Float64:
    """Return the reciprocal variances of the priors of all parameters."""
    one = [(size / _PRIOR_PX) ** 2, (size / _PRIOR_PX) ** 2, _PRIOR_GAIN**-2]
    return np.tile(one, count)


def _held(hessian: Float64) -> Float64:
    """Return the normal equations with the mean of all images held: the surface follows it."""
    held, count = hessian.copy(), len(hessian) // 3
    for axis in range(3):
        common = np.arange(3 * count) % 3 == axis
        strength = float(np.median(np.diag(hessian)[common]))
        held += strength * np.outer(common, common) / count
    return held


def _step(state: _State, damping: float) -> Float64:
    """Return the change of the shifts, whose mean stays 0."""
    system = _held(state.hessian) + np.diag(damping * np.diag(state.hessian))
    change = np.linalg.solve(system, state.gradient).reshape(-1, 3)[:, :2]
    change = np.clip(change, -1.5, 1.5)
    return np.asarray(change - change.mean(axis=0))


def _covariance(state: _State) -> Float64:
    """Return the covariance of the shifts from the scatter between parts of the object."""
    count = len(state.gradient) // 3
    inverse = np.linalg.inv(_held(state.hessian))
    scatter = state.of_tiles - state.of_tiles.mean(axis=0)
    parts = max(1, int((np.abs(state.of_tiles).sum(axis=1) > 0).sum()))
    between = inverse @ (scatter.T @ scatter * parts / max(1, parts - 1)) @ inverse
    keep = np.arange(3 * count) % 3 < 2
    return np.asarray(between[np.ix_(keep, keep)])
