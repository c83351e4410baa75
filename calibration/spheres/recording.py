"""The spheres of one recording, before those of several recordings are put together."""

from __future__ import annotations

import hashlib
from collections.abc import Container, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from acquisition import CameraModel, DataError
from acquisition.values import led_id
from calibration._errors import EstimateError
from calibration.radiance.stack import Images, Stack, check_linear
from calibration.spheres.highlights.highlights import find_highlights
from calibration.spheres.judge.drift import FOLLOWED_PX, Drift, SpheresIn, follow_camera
from calibration.spheres.judge.sphere_shifts import displaced, sphere_shifts
from calibration.spheres.outline.outline import shows_blocks
from calibration.spheres.outline.sphere_image import (
    SphereImage,
    circles_of,
    mask_warnings,
    missing_highlights_warning,
    partial_outline_warning,
    saturation_warning,
    uneven_outline_warning,
)
from calibration.spheres.propose.sphere_marks import Mask, circled_spheres, masked_spheres
from calibration.spheres.propose.sphere_selection import searched_spheres
from calibration.spheres.solve.lost_images import (
    LostImages,
    blank_images,
    moved_alone,
    moved_images,
)
from calibration.spheres.solve.sphere_positions import check_sizes, one_radius_each
from rig import Notice, listed, pluralize, short_repr
from rig.arrays import Float64

Circle = tuple[float, float, float]

_LISTED = 4
# Rows and columns of a sphere that are compared between images: noise makes each of them differ.
_COMPARED = 400
# Smaller shifts are errors of the outlines.
_STOOD_STILL_PX = 0.5
_BLOCKS = (
    "the images show the 8 px blocks of JPEG compression, which displace and hide outlines: use "
    "images without compression, or of a quality of 95"
)


@dataclass(frozen=True, eq=False)
class SeenSpheres:
    """The spheres of one recording.

    Parameters
    ----------
    names
        Names of the N lights.
    size
        Height and width of the images.
    images
        K spheres with the highlights of the lights.
    radii_mm
        ``(K,)``; None if they are not known.
    found
        Whether the spheres were searched for, not marked.
    lost
        Images that do not count; the spheres have no highlights under their lights.
    left_out
        Notices about outlines that do not count.
    doubts
        Notices about outlines, highlights and images.
    shifts_px
        ``(N, 2)``: by how much the spheres are further right and down in each image, if the camera
        was followed; None if it stood still.
    """

    names: tuple[str, ...]
    size: tuple[int, int]
    images: list[SphereImage]
    radii_mm: Float64 | None
    found: bool
    lost: LostImages
    left_out: list[Notice]
    doubts: list[Notice]
    shifts_px: Float64 | None = None

    __repr__ = short_repr


def seen_in(
    stack: Stack | Images,
    masks: Sequence[Mask] | None,
    circles: Sequence[Circle] | None,
    camera: CameraModel | None,
    radii_mm: Float64 | None,
    *,
    all_radii: bool = True,
    lights: tuple[str, ...] | None = None,
    follow: bool = False,
) -> SeenSpheres:
    """Return the spheres that a recording shows.

    Parameters and errors are those of `calibrate_spheres`.

    Parameters
    ----------
    all_radii
        Whether there is one radius for each sphere of this recording; else the recording may show
        some of the balls, which get the radii that fit their sizes.
    lights
        Order of the lights; default: that of the stack.
    follow
        Follow a camera that drifted.
    """
    gray = gray_stack(stack)
    if lights is not None and lights != gray.ids:
        gray = gray.take([gray.ids.index(name) for name in lights])
    values, names = gray.values, gray.ids
    if camera is not None and camera.size != values.shape[1:]:
        raise DataError(
            f"the camera is {camera.width} x {camera.height} pixels, the images are "
            f"{values.shape[2]} x {values.shape[1]}: use the camera of these images"
        )
    # Arrays of several masks or circles have no truth value.
    masks = [] if masks is None else list(masks)
    circles = [] if circles is None else list(circles)
    if masks and circles:
        raise DataError("both masks and circles mark the spheres: give one of the two")
    found = not masks and not circles

    # A radius has a size in the image only at a known distance.
    scaled = camera if camera is not None and camera.working_distance_mm is not None else None
    compressed = shows_blocks(values)

    def spheres_in(some: Images) -> tuple[list[SphereImage], list[Notice]]:
        try:
            if masks:
                return masked_spheres(some, masks, camera), []
            if circles:
                return circled_spheres(some, circles, camera), []
            return searched_spheres(some, camera, None if scaled is None else radii_mm)
        except EstimateError as error:
            if compressed:
                error.args = (f"{error}; {_BLOCKS}{'' if masks else ', or give a mask'}",)
            raise

    steady = _followed_spheres if follow else _steady_spheres
    images, left_out, lost, elsewhere, shifts_px = steady(gray, spheres_in)
    if not found:
        _check_apart(images)
    if radii_mm is not None:
        by_size = found or not (all_radii or len(radii_mm) == len(images))
        radii_mm = one_radius_each(radii_mm, images, scaled, found=by_size, each=all_radii)
        if circles and scaled is not None:
            check_sizes(radii_mm, images, scaled)
    size = values.shape[1], values.shape[2]
    bright = [image for image in images if image.highlights.found.any()]
    doubts = [
        *([] if masks else uneven_outline_warning(images)),
        *missing_highlights_warning(images),
        *(saturation_warning(bright) if bright else ()),
        *partial_outline_warning(images, size),
        *mask_warnings(images),
        *_copies(values, names, images),
        *([Notice("images-compressed", _BLOCKS)] if compressed else ()),
        *elsewhere,
    ]
    return SeenSpheres(names, size, images, radii_mm, found, lost, left_out, doubts, shifts_px)


class _Steady(NamedTuple):
    """Spheres whose highlights are those of all lights.

    Further: notices about outlines that do not count, the images that do not count, notices about
    spheres that are elsewhere in some images, and the shifts ``(N, 2)`` of a camera that drifted.
    """

    spheres: list[SphereImage]
    left_out: list[Notice]
    lost: LostImages
    elsewhere: list[Notice]
    shifts_px: Float64 | None = None


def _followed_spheres(stack: Stack, spheres_in: SpheresIn) -> _Steady:
    """Return the spheres as `_steady_spheres`, with the images moved back if the camera drifted.

    It is followed only if the spheres are not found at one place in all images.
    """
    try:
        steady = _steady_spheres(stack, spheres_in)
        if not steady.lost.moved:
            return steady
    except EstimateError as error:
        steady, refusal = None, error
    usable = _without(range(len(stack.ids)), blank_images(stack).lights)
    drift = None
    with suppress(EstimateError):
        drift = follow_camera(stack.values, usable, spheres_in)
    if drift is None or np.abs(drift.shifts_px).max() < _STOOD_STILL_PX:
        if steady is None:
            raise refusal
        return steady
    try:
        followed = _steady_spheres(stack, spheres_in, drift)
    except EstimateError:
        if steady is None:
            raise
        return steady
    worse = steady is not None and len(followed.lost.lights) > len(steady.lost.lights)
    return steady if steady is not None and worse else followed


def _steady_spheres(stack: Stack, spheres_in: SpheresIn, drift: Drift | None = None) -> _Steady:
    """Return the spheres of the images that agree about their places."""
    values, names = (stack.values if drift is None else drift.values), stack.ids
    lost = blank_images(stack)
    if drift is not None:
        lost = replace(lost, moved=drift.unseen)
    lost.check(names)
    rows = _without(range(len(names)), lost.lights)
    some = _taken(values, rows)
    spheres, left_out = spheres_in(some)
    known = [None if drift is None else sphere_shifts(some, one.outline) for one in spheres]
    moved = [displaced(some, one.outline, by) for one, by in zip(spheres, known, strict=True)]
    texts = moved_images(moved, spheres)
    if texts:
        lost = replace(lost, moved={**lost.moved, **{rows[k]: text for k, text in texts.items()}})
        try:
            lost.check(names)
        except EstimateError as error:
            error.spheres = circles_of(spheres)
            raise
    unsteady = {rows[k] for one in moved for k in one}
    if unsteady:
        # The outlines are those of the other images, as if these had been left out by the user.
        rows = _without(rows, lost.lights)
        steady = _without(rows, unsteady)
        if 2 * len(steady) <= len(rows):
            steady = rows  # in most images some sphere moved: few are left
        some = _taken(values, rows)
        spheres, left_out = spheres_in(_taken(values, steady))
        known = [None if drift is None else sphere_shifts(some, one.outline) for one in spheres]
        moved = [displaced(some, one.outline, by) for one, by in zip(spheres, known, strict=True)]
        if len(steady) < len(rows):  # single spheres moved: the others show the highlights
            spheres = [
                replace(one, highlights=find_highlights(some, one.outline)) for one in spheres
            ]
    shifts_px = None
    if drift is not None:
        shifts_px = drift.shifts_px.copy()
        shifts_px[rows] += np.mean([by for by in known if by is not None], axis=0)
        part = (drift.shifts_px - np.rint(drift.shifts_px))[rows]
        spheres = [
            replace(
                one,
                highlights=find_highlights(_taken(drift.sharp, rows), one.outline).moved(
                    -(part + by), FOLLOWED_PX
                ),
            )
            for one, by in zip(spheres, known, strict=True)
            if by is not None
        ]
    of_light = [rows.index(k) if k in rows else -1 for k in range(len(names))]
    notices, images = [], []
    for sphere, of_sphere in zip(spheres, moved, strict=True):
        elsewhere = {rows[k]: far_px for k, far_px in of_sphere.items()}
        notices += moved_alone(names, elsewhere, sphere)
        shown = [-1 if k in elsewhere else row for k, row in enumerate(of_light)]
        complete = min(shown, default=0) >= 0
        highlights = sphere.highlights if complete else sphere.highlights.take(shown)
        images.append(replace(sphere, highlights=highlights))
    return _Steady(images, left_out, lost, notices, shifts_px)


def _without(rows: Iterable[int], lost: Container[int]) -> list[int]:
    return [k for k in rows if k not in lost]


def _taken(values: Images, rows: list[int]) -> Images:
    return values if len(rows) == len(values) else values[rows]


def _copies(values: Images, names: Sequence[str], images: Sequence[SphereImage]) -> list[Notice]:
    """Return a warning about lights that have the same image of a sphere, to the last bit."""
    largest = max(images, key=lambda image: image.outline.radius_px)
    low = np.subtract(largest.outline.centre_px, largest.outline.radius_px)
    high = np.add(largest.outline.centre_px, largest.outline.radius_px)
    columns, rows = (
        slice(max(int(first), 0), max(int(last), 0) + 1, int(last - first) // _COMPARED + 1)
        for first, last in zip(low, high, strict=True)
    )
    lights: dict[bytes, list[str]] = {}
    for k, name in enumerate(names):
        content = values[k, rows, columns]
        if content.size and np.ptp(content) != 0:  # an even image is not a picture
            digest = hashlib.blake2b(content.tobytes()).digest()
            lights.setdefault(digest, []).append(name)
    equal = [" and ".join(same[:_LISTED]) for same in lights.values() if len(same) > 1]
    text = (
        f"the images of {listed(equal, _LISTED, '; ')} are the same image: one of them is missing, "
        "and its light is wrong; restore the image"
    )
    return [Notice("image-duplicate", text)] if equal else []


def _check_apart(images: Sequence[SphereImage]) -> None:
    """Raise `DataError` if two marks are the same sphere, which must not count twice."""
    for one, other in combinations([image.outline for image in images], 2):
        if one.apart_px(other) < min(one.radius_px, other.radius_px):
            x, y = one.centre_px
            raise DataError(f"two marks are the sphere at ({x:.0f}, {y:.0f}) px: mark it once")


def named_stack(stack: Stack | Images) -> Stack:
    """Return a stack, or that of an array of images of the lights ``L00``..."""
    if isinstance(stack, Stack):
        return stack
    values = np.asarray(stack, np.float32)
    return Stack(values, tuple(map(led_id, range(len(np.atleast_1d(values))))), None)


def gray_stack(stack: Stack | Images) -> Stack:
    """Return a stack of grey values ``(N, H, W)`` with the names of the N lights."""
    check_linear("stack", stack)
    stack = named_stack(stack)
    values, names = stack.values, stack.ids
    if values.ndim == 4:
        values = values.mean(axis=3)  # a NaN channel makes the sample NaN
    if values.ndim != 3 or 0 in values.shape:
        raise DataError(
            f"a stack of sphere images must have the shape (N, H, W[, 3]), not {values.shape}"
        )
    if len(names) != len(values):
        raise DataError(
            f"{pluralize(len(names), 'light')} for {pluralize(len(values), 'image')}: give one for "
            "each image"
        )
    return Stack(values, names, None, peaks=stack.peaks)
