"""Light that an object reflects onto itself, from the images and the shape that they show."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from acquisition import Lights
from calibration.radiance import luma
from processing.images.coarse_images import CoarseImages, coarse_images
from processing.images.recorded_images import RecordedImages
from processing.images.reflected_light import ReflectedLight
from processing.images.viewing_rays import Perspective, View
from processing.stereo.method import Method
from processing.stereo.normals_and_albedo import photometric_stereo
from rig import Notice
from rig.arrays import Bool, Float32, Float64

# Squares of pixels on the object: at most four times as many, with 16 bytes per pair of them.
_SQUARES = 1500
_ROUNDS = 2
# Samples are in attached shadow if the cosine between normal and light is below this.
_BEHIND = -0.1
_FEWEST = 200
# Steps along a line of sight, in squares; what is within the last of them hides nothing, nor does
# what is above the line by less than this share of a square.
_STEP, _NEXT, _ABOVE = 0.7, 1.2, 0.1
# Squares that are seen at a smaller cosine are not larger than this makes them.
_LEAST_FACING = 0.15
# Less of the variance of attached shadows may have other causes.
_LEAST_EXPLAINED = 0.5
_LEAST_LIGHT = np.float32(1e-9)


class Interreflection(NamedTuple):
    """Light of the object in its images.

    Parameters
    ----------
    light
        The light; None if shadows do not show it.
    strength
        Its strength relative to that of a matte surface with the albedo found, which is 1 if
        radiance and intensities are absolute.
    explained
        Share 0 to 1 of the variance of attached shadows that it explains.
    """

    light: ReflectedLight | None
    strength: float
    explained: float

    @property
    def notice(self) -> Notice:
        """Whether light was subtracted."""
        if self.light is None:
            text = (
                "no light that the object reflects onto itself was subtracted: attached shadows do "
                f"not show it (it explains {self.explained:.0%} of their brightness, not half)"
            )
        else:
            share = float(np.mean(np.abs(self.light.shares)))
            text = (
                f"light that the object reflects onto itself was subtracted, {share:.1%} of the "
                f"images; it explains {self.explained:.0%} of the brightness of attached shadows"
            )
        return Notice("light-reflected", text, severity="info")


def find_interreflection(
    images: RecordedImages,
    lights: Lights,
    mask: Bool,
    view: View,
    depth_mm: Float32 | None,
    method: Method,
) -> Interreflection:
    """Find the light that a matte object reflects onto itself.

    Each part receives the light that the other parts which it faces send, as the images show it,
    all reflections included, and reflects it by its albedo (Nayar, Ikeuchi and Kanade, "Shape from
    interreflections", 1991). The shape shows which parts face each other; it is computed again from
    the images without this light. The strength is that which attached shadows show, because the
    scale of the albedo may not be known. Light that does not explain half of their variance is not
    subtracted.

    This works on 1,500 to 6,000 squares of pixels; memory and time grow with the square of their
    number, up to 300 MB and some seconds.

    Parameters
    ----------
    images
        N images.
    lights
        The N lights.
    mask
        ``(H, W)`` bool, the object.
    view
        How the pixels see the surface.
    depth_mm
        ``(H, W)`` depths, for lights with positions.
    method
        Method of `photometric_stereo`.
    """
    coarse = coarse_images(images, mask, view, _SQUARES)
    if not coarse.mask.any():
        return Interreflection(None, 0.0, 0.0)
    measured = _in_channels(images, coarse, mask, view)
    distance = np.full(coarse.mask.shape, view.distance_mm)
    if depth_mm is not None:
        distance = coarse_images(depth_mm[None], mask, view, _SQUARES).values[0].astype(np.float64)
    points = coarse.points(distance)
    vectors = lights.vectors_at(points)
    middle = float(distance[coarse.mask].mean())
    light = np.zeros_like(measured)
    for _ in range(_ROUNDS):
        stereo = photometric_stereo(
            _gray(measured - light),
            lights,
            coarse.mask,
            method=method,
            points_mm=points,
            camera=coarse.view.seen_by,
        )
        depth, inside = coarse.view.surface(stereo.normal_map, middle)
        normals = stereo.normal_map.normals[inside].astype(np.float64)
        shading = np.einsum("npc,pc->np", vectors[:, inside], normals)
        irradiance = np.linalg.norm(vectors[:, inside], axis=2)
        own, gray = measured[:, inside], stereo.albedo[inside]
        brightness = _mean(own)
        albedo = brightness * (gray / np.maximum(_gray(brightness), _LEAST_LIGHT))[:, None]
        # A highlight is not reflected as by a matte surface; a saturated sample is predicted.
        sent = np.where(np.isfinite(own), own, albedo * np.maximum(shading, 0)[..., None])
        sent = np.clip(sent, 0, albedo * irradiance[..., None])
        factors = _form_factors(coarse, depth, inside, normals)
        received = np.tensordot(factors, sent.astype(np.float32), (1, 1)).swapaxes(0, 1)
        received *= albedo
        shadows = (shading < _BEHIND * irradiance) & (gray > 0) & np.isfinite(_gray(own))
        of_pixel = np.broadcast_to(gray, shading.shape)
        strength, explained = _strength(
            *(values[shadows] for values in (_gray(own), _gray(received), of_pixel))
        )
        if not (strength > 0 and explained > _LEAST_EXPLAINED):
            return Interreflection(None, strength, explained)
        light = np.zeros_like(measured)
        light[:, inside] = strength * received
    shares = light[:, inside] / np.maximum(brightness, _LEAST_LIGHT)
    reflected = ReflectedLight(_nearest(shares, inside), coarse.factor, _mean_of(images))
    return Interreflection(reflected, strength, explained)


def _gray(values: Float32) -> Float32:
    return luma(values) if values.shape[-1] > 1 else values[..., 0]


def _mean(values: Float32) -> Float32:
    """Return the mean of the finite values along the first axis."""
    known = np.isfinite(values)
    total = np.where(known, values, 0).sum(axis=0)
    return np.asarray(total / np.maximum(known.sum(axis=0), 1), np.float32)


def _mean_of(images: RecordedImages) -> Float32:
    """Return the mean of all images, of which one at a time is in memory if they are gray."""
    if images.in_colour:
        return _mean(images.stack(colour=True).values)
    total = np.zeros(images.size)
    count = np.zeros(images.size, np.int32)
    for image in images:
        known = np.isfinite(image)
        total[known] += image[known]
        count += known
    return np.asarray(total / np.maximum(count, 1), np.float32)


def _in_channels(images: RecordedImages, coarse: CoarseImages, mask: Bool, view: View) -> Float32:
    """Return coarse images ``(N, h, w, C)`` of all colours."""
    if not images.in_colour:
        return coarse.values[..., None]
    values = images.stack(colour=True).values
    channels = (np.ascontiguousarray(values[..., c]) for c in range(values.shape[-1]))
    parts = [coarse_images(channel, mask, view, _SQUARES).values for channel in channels]
    return np.stack(parts, axis=-1)


def _strength(seen: Float32, predicted: Float32, albedo: Float32) -> tuple[float, float]:
    """Return the factor of predicted light besides a constant one, and how much it explains."""
    if len(seen) < _FEWEST or not predicted.any():
        return 0.0, 0.0
    # Parts of both that are not those of a constant light on the albedo.
    seen, predicted = (
        values - albedo * np.float32((values @ albedo) / (albedo @ albedo))
        for values in (seen, predicted)
    )
    both, own, all_ = predicted @ seen, predicted @ predicted, seen @ seen
    return float(both / own), float(both * both / (own * all_))


def _nearest(shares: Float32 | Float64, inside: Bool) -> Float32:
    """Return ``(N, h, w[, 3])`` shares; outside, those of the nearest square inside."""
    # Imported here: it takes 0.2 s.
    from scipy.ndimage import distance_transform_edt

    whole = np.zeros((len(shares), *inside.shape, shares.shape[-1]), np.float32)
    whole[:, inside] = shares
    rows, columns = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    filled = whole[:, rows, columns]
    return filled[..., 0] if shares.shape[-1] == 1 else filled


def _form_factors(coarse: CoarseImages, depth: Float64, inside: Bool, normals: Float64) -> Float32:
    """Return the ``(P, P)`` shares of the light of matte squares that others receive."""
    whole = np.full(inside.shape, np.nan)
    whole[inside] = depth
    points, rays = coarse.points(whole)[inside], coarse.rays[inside]
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    # What changes evenly along the picture of a straight line, and grows toward the camera.
    if isinstance(coarse.view, Perspective):
        side, near = depth / coarse.view.camera.focal_px, 1 / whole
        above = float(np.mean(side / depth**2))
    else:
        side, near = np.full(len(depth), coarse.view.pixel_mm), -whole
        above = coarse.view.pixel_mm
    facing = np.maximum(-(normals * rays).sum(axis=1), _LEAST_FACING)
    areas = side**2 * np.abs(rays[:, 2]) / facing
    places = np.argwhere(inside).astype(np.float64)
    factors = np.zeros((len(depth), len(depth)), np.float32)
    _exchange(near, _ABOVE * above, places, points, normals, areas, factors)
    return factors


@numba.njit(nogil=True, cache=True)
def _exchange(
    near: Float64, above: float, places: Float64, points: Float64, normals: Float64,
    areas: Float64, factors: Float32,
) -> None:  # fmt: skip
    """Write the form factors of pairs that face each other and have nothing between them.

    A square is a disc that faces the other point as the square does.
    """
    for i in range(len(points)):
        for j in range(i + 1, len(points)):
            here = there = distance2 = 0.0
            for c in range(3):
                across = points[j, c] - points[i, c]
                here += normals[i, c] * across
                there -= normals[j, c] * across
                distance2 += across * across
            if here > 0 and there > 0 and _seen(near, above, places[i], places[j]):
                both = here * there / distance2
                factors[i, j] = both * areas[j] / (math.pi * distance2 + areas[j])
                factors[j, i] = both * areas[i] / (math.pi * distance2 + areas[i])


@numba.njit(nogil=True, cache=True)
def _seen(near: Float64, above: float, one: Float64, other: Float64) -> bool:
    """Return whether the surface is nowhere above the line between two of its places."""
    down, across = other[0] - one[0], other[1] - one[1]
    length = max(abs(down), abs(across))
    steps = math.ceil(length / _STEP)
    begin = near[int(one[0]), int(one[1])]
    rise = near[int(other[0]), int(other[1])] - begin
    for k in range(1, steps):
        t = k / steps
        if min(t, 1 - t) * length < _NEXT:
            continue
        row, column = one[0] + t * down, one[1] + t * across
        r, c = min(int(row), near.shape[0] - 2), min(int(column), near.shape[1] - 2)
        a, b = row - r, column - c
        surface = (1 - a) * ((1 - b) * near[r, c] + b * near[r, c + 1])
        surface += a * ((1 - b) * near[r + 1, c] + b * near[r + 1, c + 1])
        # Gaps of the surface, which are NaN, hide nothing.
        if surface > begin + t * rise + above:
            return False
    return True
