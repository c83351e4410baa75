"""Enlarge rows of a normal map tile by tile."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np

from acquisition import MapRows
from processing.detail.rotation import rotate_from_z
from processing.detail.shape_filter import ShapeFilter
from processing.maps.metrics import angle_map_deg
from processing.maps.normal_map import NormalMap
from processing.noise.normal_errors import UNIFORM_DEG
from processing.superres.method import PixelSampling
from processing.superres.model import Domain
from processing.superres.network import Network
from rig.arrays import AnyArray, Bool, Float32

# How far the functions here depend on the surroundings of a pixel.
REACH_PX = 3
_LEAST_LENGTH = 1e-6
_FACING = np.array([0, 0, 1], np.float32)
_LAPLACE = np.array([[0, 1, 0], [1, -4, 1], [0, 1, 0]], np.float32)
_PLACES = np.arange(-3, 4)
# Roughness at which half of the network's result is used, in radians: fourth differences.
_HALF = 0.004
_BINOMIAL = np.array([0.25, 0.5, 0.25], np.float32)
_LEAST = np.float32(1e-12)
# A blend is at most this much better than both results, in mean-square error.
_LEAST_SHARE = np.float32(0.25)
# Side of the square whose mean is the normal at the centre of a large pixel.
_CENTRAL_PX = 2


class Span(NamedTuple):
    """Some of the rows or columns of an image, and those on which their result depends.

    Parameters
    ----------
    core
        The rows or columns themselves.
    around
        Those with the halo, cut at the border of the image.
    inside
        The core, counted from the first of `around`.
    """

    core: slice
    around: slice
    inside: slice


def spans(length: int, side: int, halo: int) -> list[Span]:
    """Return the parts of the rows or columns of an image.

    Parameters
    ----------
    length
        Number of rows or columns.
    side, halo
        Length of the parts, and width of the halo around them.
    """
    made = []
    for first in range(0, length, side):
        last = min(first + side, length)
        begin, end = max(first - halo, 0), min(last + halo, length)
        core, inside = slice(first, last), slice(first - begin, last - begin)
        made.append(Span(core, slice(begin, end), inside))
    return made


def enlarged_rows(rows: slice, scale: int) -> slice:
    """Return rows in pixels of a resolution that is higher by a factor."""
    return slice(rows.start * scale, rows.stop * scale)


def _roughness_gate(low: Float32) -> Float32:
    """Return, per pixel of a low resolution, the weight of a network where it is reliable, 0 to 1.

    Where a map is smooth, its fourth differences vanish, interpolation is exact, and there is
    nothing to add. Second differences would not do: those of steep waves are large.

    Parameters
    ----------
    low
        ``(h, w, 3)`` unit vectors.
    """
    rough = low
    for _ in range(2):
        smooth = cv2.sepFilter2D(rough, -1, _BINOMIAL, _BINOMIAL, borderType=cv2.BORDER_REFLECT_101)
        rough = rough - smooth
    energy = (rough**2).sum(axis=2)
    energy = cv2.blur(energy, (5, 5), borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(energy / (energy + _HALF**2), np.float32)


def blend(
    smooth: Float32, sharp: Float32, square: Float32, errors: Float32, gate: Float32
) -> tuple[Float32, Float32]:
    """Blend an interpolation and the result of a network.

    The weight of the network is 1, less where it expects to be worse than bicubic interpolation
    (the ratio of the mean-square errors), and less where the map is smooth. With v_b and v_n the
    mean-square errors and r the difference of the results, the mean-square error of the blend with
    the weight w is (1 - w) v_b + w v_n - w (1 - w) r^2.

    Parameters
    ----------
    smooth, sharp
        ``(H, W, 3)`` unit vectors: an interpolation, and the result of the network.
    square
        ``(H, W)`` r^2, the squared distance of the network's result from bicubic interpolation.
    errors
        ``(H, W, 2)`` mean-square errors of the network's result and of bicubic interpolation.
    gate
        ``(H, W)`` largest weight, 0 to 1.

    Returns
    -------
    normals, variance
        ``(H, W, 3)`` unit vectors, and ``(H, W)`` mean-square errors in radians squared.
    """
    ours, theirs = errors[..., 0], errors[..., 1]
    weight = np.minimum(1, theirs / np.maximum(ours, _LEAST)) * gate
    variance = (1 - weight) * theirs + weight * ours - weight * (1 - weight) * square
    floor = _LEAST_SHARE * np.minimum(theirs, ours)
    normals = units(smooth + weight[..., None] * (sharp - smooth))
    return normals, np.asarray(np.maximum(variance, floor), np.float32)


@dataclass(frozen=True, eq=False)
class LowMap:
    """Rows of a map of the low resolution and its components, continued beyond their mask.

    Parameters
    ----------
    normals, shape, detail
        ``(h, w, 3)`` unit vectors; the combination of shape and detail is the map.
    central
        ``(h, w, 3)`` vectors at the centres of the pixels, whose means the normals are.
    given, side
        ``(h, w, 3)`` normals that the result keeps: the means of this many pixels in each direction
        in the middle of each large pixel.
    gate
        ``(h, w)`` largest weight of a network.
    mask
        ``(h, w)`` where the map is known.
    reach
        ``(h, w)`` where the result may have pixels: the mask and its neighbours.
    """

    normals: Float32
    shape: Float32
    detail: Float32
    central: Float32
    given: Float32
    side: int
    gate: Float32
    mask: Bool
    reach: Bool

    @classmethod
    def of(
        cls,
        normals: MapRows,
        mask: Bool,
        rows: slice,
        scale: int,
        halo: int,
        sampling: PixelSampling = "area",
    ) -> LowMap:
        """Separate rows of a map, and continue its components as far as a network can see."""
        read = _with_margin(rows, margin_rows(halo), len(mask))
        near = _with_margin(rows, halo, len(mask))
        part = NormalMap.of_unit_vectors(
            np.ascontiguousarray(normals[read], np.float32), mask[read]
        )
        given, side = part.normals[_within(rows, read)].copy(), scale
        if sampling == "points":
            part, side = means_of_points(part, scale), _CENTRAL_PX
        cut, inner = _within(near, read), _within(rows, near)
        # One after the other, because copies of all of them would take much memory.
        vectors = [part.normals[cut].copy(), *(each[cut].copy() for each in _components(part))]
        del part
        for number, each in enumerate(vectors):
            vectors[number] = filled_outwards(each, mask[near], halo)
        central = without_averaging(vectors[0], scale)[inner]
        gate = _roughness_gate(vectors[0])[inner]
        normals, shape, detail = (each[inner] for each in vectors)
        reach = reached(mask[near])[inner]
        return cls(normals, shape, detail, central, given, side, gate, mask[rows], reach)


def margin_rows(halo: int) -> int:
    """Return the rows above and below that `LowMap.of` reads, of a network with a halo."""
    # What the continuation, the filter and the means of points depend on.
    return halo + ShapeFilter().halo + 2 * REACH_PX


def reached(mask: Bool) -> Bool:
    """Return where a result may have pixels: a mask of the low resolution and its neighbours."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


def enlarge(
    low: LowMap,
    rows: slice,
    columns: Span,
    scale: int,
    wanted: Bool | None,
    network: Network | None,
    domain: Domain,
    self_ensemble: bool,
) -> dict[str, AnyArray]:
    """Compute a tile of the high resolution.

    Parameters
    ----------
    low
        Rows of the map.
    rows, columns
        The rows and the columns of the tile.
    scale
        Factor of the resolution.
    wanted
        Mask of the high resolution, of the tile; None for the enlarged mask of the map.
    network, domain, self_ensemble
        The network, None for bicubic interpolation; what it was trained on; whether the mean of
        turned copies is used.

    Returns
    -------
    dict
        The maps of `SuperResolution`, 0 outside the mask, and ``detail_deg``: the angles between
        interpolation without a network and the shape.
    """
    core, around = (rows, columns.core), (slice(None), columns.around)
    inside = enlarged_rows(rows, scale), enlarged_rows(columns.inside, scale)
    if wanted is None:
        mask = _enlarged_mask(low.mask[around], scale)[inside]
    else:
        mask = low.reach[core].repeat(scale, axis=0).repeat(scale, axis=1) & wanted
    shape = units(bicubic(low.shape[around], scale)[inside])
    plain = normals = units(bicubic(low.normals[around], scale)[inside])
    made: dict[str, AnyArray] = {"mask": mask}
    if network is not None:
        plain = units(smoothly(low.central[around], scale)[inside])
        vectors = (low.detail if domain == "detail" else low.normals)[around]
        answer = (network.run_turned if self_ensemble else network.run)(vectors)[inside]
        sharp = units(bicubic(vectors, scale)[inside] + answer[..., :3])
        if domain == "detail":
            sharp = rotate_from_z(sharp, shape)
        square = ((sharp - normals) ** 2).sum(axis=2)
        gate = np.clip(bicubic(low.gate[around], scale)[inside], 0, 1)
        normals, variance = blend(plain, sharp, square, np.exp(answer[..., 3:]), gate)
        normals = with_given(normals, low.given[core], mask, low.side)
        known = network.deviations
        variance = variance if known is None else known.corrected(variance)
        sigma = np.float32(math.degrees(1)) * np.sqrt(variance)
        sigma = np.minimum(sigma, np.float32(UNIFORM_DEG))
        made["sigma_deg"] = np.where(mask, sigma, np.float32(np.nan))
    added, detail = (
        np.where(mask, angle_map_deg(*pair, mask), np.float32(0))
        for pair in ((normals, plain), (plain, shape))
    )
    squares = added**2
    made["invented"] = squares / np.maximum(squares + detail**2, np.float32(1e-12))
    made["normals"] = np.where(mask[..., None], normals, np.float32(0))
    return made | {"added_deg": added, "detail_deg": detail}


def _with_margin(rows: slice, margin: int, height: int) -> slice:
    return slice(max(rows.start - margin, 0), min(rows.stop + margin, height))


def _within(rows: slice, outer: slice) -> slice:
    """Return rows as rows of a part of the map."""
    return slice(rows.start - outer.start, rows.stop - outer.start)


def _components(normal_map: NormalMap) -> tuple[Float32, Float32]:
    """Return shape and detail; a map that is smaller than the filter's window is padded."""
    shape_filter = ShapeFilter()
    least = 2 * shape_filter.w + 1
    rows, columns = (max(least - length, 0) for length in normal_map.size)
    padded = NormalMap.of_unit_vectors(
        np.pad(normal_map.normals, ((0, rows), (0, columns), (0, 0))),
        np.pad(normal_map.mask, ((0, rows), (0, columns))),
    )
    height, width = normal_map.size
    shape, detail = (part.normals[:height, :width] for part in shape_filter.split(padded))
    return shape, detail


def means_of_points(normal_map: NormalMap, scale: int) -> NormalMap:
    """Return the means over pixels of a map that has the normals at their centres.

    Parameters
    ----------
    normal_map
        The map. It is continued beyond its mask first.
    scale
        How many pixels of the higher resolution are in a pixel, in each direction.
    """
    mask = normal_map.mask
    means = units(averaged(filled_outwards(normal_map.normals, mask, REACH_PX), scale))
    return NormalMap.of_unit_vectors(np.where(mask[..., None], means, np.float32(0)), mask)


def with_given(high: Float32, low: Float32, mask: Bool, side: int) -> Float32:
    """Turn the normals of each large pixel alike, so that the mean of the inner ones is as given.

    Small errors that all normals of a pixel have in common add up to large errors of heights. The
    difference of the means is added once, which leaves an error of the second order.

    Parameters
    ----------
    high
        ``(s h, s w, 3)`` unit vectors.
    low
        ``(h, w, 3)`` unit vectors, the given normals.
    mask
        ``(s h, s w)`` where `high` is part of a map. Large pixels that are not complete stay as
        they are.
    side
        Side of the inner square: s for given means, 2 for given normals at the centres.
    """
    height, width = low.shape[:2]
    scale = len(high) // height
    blocks = high.reshape(height, scale, width, scale, 3)
    complete = mask.reshape(height, scale, width, scale).all(axis=(1, 3))
    inner = slice((scale - side) // 2, (scale + side) // 2)
    difference = low - units(blocks[:, inner, :, inner].mean(axis=(1, 3)))
    difference[~complete] = 0
    return units((blocks + difference[:, None, :, None]).reshape(high.shape))


def filled_outwards(vectors: Float32, mask: Bool, rings: int) -> Float32:
    """Continue unit vectors beyond their mask, ring by ring.

    Each ring consists of the neighbours of the known pixels and takes the mean direction of those
    among its eight neighbours. A mirrored or turned map gives the mirrored or turned result.

    Parameters
    ----------
    vectors
        ``(H, W, 3)`` float32, unit vectors inside the mask and 0 outside.
    mask
        ``(H, W)`` bool.
    rings
        How many pixels far to continue; beyond, the result is (0, 0, 1).

    Returns
    -------
    Float
        ``(H, W, 3)`` float32 unit vectors.
    """
    filled, known = vectors.copy(), mask.copy()
    for _ in range(rings):
        if known.all():
            break
        sums = cv2.boxFilter(filled, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        near = cv2.dilate(known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        ring = near & ~known
        sums = sums[ring]
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        means = sums / np.maximum(length, _LEAST_LENGTH)
        # Opposite neighbours cancel out; such a pixel faces the camera.
        filled[ring] = np.where(length > _LEAST_LENGTH, means, _FACING)
        known |= ring
    filled[~known] = (0, 0, 1)
    return filled


def bicubic(values: Float32, scale: int) -> Float32:
    """Interpolate an image bicubically with a = -0.75, as OpenCV and torch do.

    Parameters
    ----------
    values
        ``(h, w)`` or ``(h, w, C)`` float32; the border is replicated.
    scale
        Factor of the size.

    Returns
    -------
    Float
        Image of ``scale * h`` x ``scale * w`` pixels.
    """
    size = (scale * values.shape[1], scale * values.shape[0])
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_CUBIC), np.float32)


def without_averaging(values: Float32, scale: int) -> Float32:
    """Return the values at the centres of pixels that are means over their area.

    The mean over a square is the value at its centre plus 1/24 of the Laplacian, as far as it is
    smooth; of the pixels of the higher resolution, which are means as well, the same is left.

    Parameters
    ----------
    values
        ``(h, w, 3)`` float32.
    scale
        How many pixels of the higher resolution are in a pixel, in each direction.
    """
    curved = cv2.filter2D(values, -1, _LAPLACE, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(values - np.float32((1 - scale**-2) / 24) * curved, np.float32)


def averaged(values: Float32, scale: int) -> Float32:
    """Return the means over pixels of values at their centres, interpolated as `smoothly` does.

    Parameters
    ----------
    values
        ``(h, w, 3)`` float32; the border is replicated.
    scale
        How many pixels of the higher resolution are in a pixel, in each direction.
    """
    kernel = np.mean(_kernels(scale), axis=0)
    return np.asarray(
        cv2.sepFilter2D(values, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE), np.float32
    )


def smoothly(values: Float32, scale: int) -> Float32:
    """Interpolate an image by cubic convolution over six pixels, which is exact for cubics.

    Bicubic interpolation with a = -0.75 is sharper at edges, but not exact even for a ramp. From R.
    Keys, *Cubic convolution interpolation for digital image processing*, 1981, section VI.

    Parameters
    ----------
    values
        ``(h, w, C)`` float32; the border is replicated.
    scale
        Factor of the size.

    Returns
    -------
    Float
        Image of ``scale * h`` x ``scale * w`` pixels.
    """
    height, width, channels = values.shape
    out = np.zeros((scale * height, scale * width, channels), np.float32)
    kernels = _kernels(scale)
    for row, column in product(range(scale), repeat=2):
        out[row::scale, column::scale] = cv2.sepFilter2D(
            values, -1, kernels[column], kernels[row], borderType=cv2.BORDER_REPLICATE
        )
    return out


def _enlarged_mask(mask: Bool, scale: int) -> Bool:
    """Return a mask at a higher resolution, with a smooth outline of about the same area."""
    size = (scale * mask.shape[1], scale * mask.shape[0])
    share = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(share >= 0.5)


def units(vectors: Float32) -> Float32:
    """Return vectors of unit length; those that cancel out face the camera."""
    length = np.linalg.norm(vectors, axis=2, keepdims=True)
    scaled = vectors / np.maximum(length, _LEAST_LENGTH)
    return np.asarray(np.where(length > _LEAST_LENGTH, scaled, _FACING), np.float32)


def _kernels(scale: int) -> list[Float32]:
    """Return the weights of cubic convolution at the pixels of the higher resolution."""
    return [_weights((k + 0.5) / scale - 0.5) for k in range(scale)]


def _weights(offset: float) -> Float32:
    """Return the weights of the seven nearest pixels at an offset from the middle one."""
    away = np.abs(offset - _PLACES)
    pieces = (
        (4 / 3 * away - 7 / 3) * away**2 + 1,
        ((-7 / 12 * away + 3) * away - 59 / 12) * away + 15 / 6,
        ((1 / 12 * away - 2 / 3) * away + 21 / 12) * away - 3 / 2,
    )
    return np.asarray(np.select([away <= 1, away <= 2, away < 3], pieces, 0), np.float32)
