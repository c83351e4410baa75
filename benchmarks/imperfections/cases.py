"""Imperfections of a recording, each with three strengths."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from acquisition import Lights
from benchmarks.imperfections.recordings import Form, Recording
from rig.arrays import Float32, Float64

Change = Callable[[Recording, float], Recording]

# Light that is added to all samples; under even albedo, images do not distinguish these.
_ADDED = {"ambient-light", "black-level"}
_CLAHE_TILES = (6, 6)
_SCATTER_SEED = 77201


@dataclass(frozen=True)
class Case:
    """An imperfection.

    Parameters
    ----------
    unit
        What the strength is.
    strengths
        Three strengths, the usual one first; one if it cannot be graded.
    change
        Returns the imperfect recording.
    causes
        Names of the causes that are right.
    distant
        Names that are right, too, under distant lights, which do not distinguish these causes.
    near
        It exists only under near lights.
    hidden
        Where images do not show it: on ``flat`` objects, under ``distant`` lights.
    """

    unit: str
    strengths: tuple[float, ...]
    change: Change
    causes: tuple[str, ...]
    distant: tuple[str, ...] = ()
    near: bool = False
    hidden: tuple[str, ...] = ()

    def applies_to(self, recording: Recording) -> bool:
        return recording.lights.near or not self.near

    def shown_by(self, recording: Recording) -> bool:
        """Return whether images can show it."""
        hides = {"flat": recording.flat, "distant": not recording.lights.near}
        return not any(hides[one] for one in self.hidden)

    def named_in(self, names: Iterable[str], recording: Recording) -> bool:
        """Return whether a right name is among these."""
        right = {*self.causes, *(() if recording.lights.near else self.distant)}
        if recording.uniform and right & _ADDED:
            right |= _ADDED
        return not right.isdisjoint(names)


def _srgb(values: Float32) -> Float32:
    x = np.clip(values, 0, 1)
    bright = 1.055 * x ** (1 / 2.4) - 0.055
    return np.where(x <= 0.0031308, 12.92 * x, bright).astype(np.float32)


def _with(change: Callable[[Float32, float], Float32], form: Form | None = None) -> Change:
    """Return a change of the images alone, and of the form of their files."""

    def changed(r: Recording, strength: float) -> Recording:
        images = np.asarray(change(r.images, strength), np.float32)
        return replace(r, images=images, form=form or r.form)

    return changed


def _placed(change: Callable[[Float64, float], Float64]) -> Change:
    """Return a change of the positions or directions of the lights; their axes stay."""

    def changed(r: Recording, strength: float) -> Recording:
        return replace(r, lights=_at(r.lights, change(_places(r.lights), strength), r.lights.axes))

    return changed


def _signed(*signs: int) -> Change:
    """Return a change of the signs of coordinates of the lights, their axes included."""

    def changed(r: Recording, _: float) -> Recording:
        axes = None if r.lights.axes is None else r.lights.axes * signs
        return replace(r, lights=_at(r.lights, _places(r.lights) * signs, axes))

    return changed


def _places(lights: Lights) -> Float64:
    return np.array(lights.positions_mm if lights.near else lights.unit_directions)


def _at(lights: Lights, places: Float64, axes: Float64 | None) -> Lights:
    if lights.near:
        return replace(lights, positions_mm=places, axes=axes, errors=None)
    return replace(lights, directions=places, errors=None)


def _states(factors: Callable[[Recording, float], Float64]) -> Change:
    """Return a change of the stated intensities by a factor for each light."""

    def changed(r: Recording, strength: float) -> Recording:
        stated = np.asarray(r.lights.intensities) * factors(r, strength)[:, None]
        return replace(r, lights=replace(r.lights, intensities=stated, errors=None))

    return changed


def _over_images(factors: Float64, images: Float32) -> Float32:
    return np.asarray(images * factors.reshape(-1, *[1] * (images.ndim - 1)), np.float32)


def _shifted(image: Float32, right: float, down: float = 0.0) -> Float32:
    by = np.array([[1, 0, right], [0, 1, down]], np.float32)
    size = (image.shape[1], image.shape[0])
    moved = cv2.warpAffine(image, by, size, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.float32)


def _moved(rights: Float64, images: Float32) -> Float32:
    return np.stack([_shifted(image, x) for image, x in zip(images, rights, strict=True)])


def _half_moved(images: Float32, px: float) -> Float32:
    count = len(images)
    return _moved(np.where(np.arange(count) < count // 2, 0.0, px), images)


def _drift(images: Float32, px: float) -> Float32:
    return _moved(px * np.linspace(0, 1, len(images)), images)


def _one_moved(images: Float32, px: float) -> Float32:
    changed = images.copy()
    place = len(images) // 3
    changed[place] = _shifted(images[place], 0.0, px)
    return changed


def _one_brighter(images: Float32, part: float) -> Float32:
    changed = images.copy()
    changed[len(images) // 3] *= np.float32(1 + part)
    return changed


def _fading(images: Float32, part: float) -> Float32:
    return _over_images(1 - part * np.linspace(0, 1, len(images)), images)


def _room_light(images: Float32, part: float) -> Float32:
    return np.asarray(images + part * images.mean(axis=0), np.float32)


def _changing_room_light(images: Float32, part: float) -> Float32:
    shares = np.random.default_rng(_SCATTER_SEED).uniform(0, 2 * part, len(images))
    room = images.mean(axis=0)
    return np.stack([image + share * room for image, share in zip(images, shares, strict=True)])


def _local_tone(images: Float32, clip: float) -> Float32:
    clahe = cv2.createCLAHE(clip, _CLAHE_TILES)

    def toned(image: Float32) -> Float32:
        levels = np.rint(image * 255).astype(np.uint8)
        planes = [clahe.apply(np.ascontiguousarray(plane)) for plane in cv2.split(levels)]
        return np.asarray(cv2.merge(planes) / 255, np.float32)

    return np.stack([toned(image) for image in _srgb(images)])


def _tone_curve(images: Float32, depth: float) -> Float32:
    display = _srgb(images)
    return np.asarray(display - depth * np.sin(2 * np.pi * display), np.float32)


def _clipped(images: Float32, share: float) -> Float32:
    """Clip a share of the samples on the object, about, below white."""
    lit = images[images > 0.05]
    return np.minimum(images, np.float32(np.quantile(lit, 1 - share)))


def _vignetted(images: Float32, loss: float) -> Float32:
    height, width = images.shape[1:3]
    y, x = np.mgrid[:height, :width]
    squared = ((x - (width - 1) / 2) ** 2 + (y - (height - 1) / 2) ** 2) / (width / 2) ** 2
    fall = 1 - loss * squared.clip(0, 1.6)
    return np.asarray(images * fall.reshape(height, width, *[1] * (images.ndim - 3)), np.float32)


def _swapped(images: Float32, pairs: float) -> Float32:
    order = np.arange(len(images))
    for pair in range(int(pairs)):
        first = (4 + 3 * pair) % (len(images) - 1)
        order[[first, first + 1]] = order[[first + 1, first]]
    return images[order]


def _rolled(images: Float32, by: float) -> Float32:
    return np.roll(images, int(by), axis=0)


def _shuffled(images: Float32, _: float) -> Float32:
    return images[np.random.default_rng(_SCATTER_SEED).permutation(len(images))]


def _one_repeated(images: Float32, _: float) -> Float32:
    """Replace one image by a copy of another one."""
    changed = images.copy()
    changed[len(images) // 3] = images[len(images) // 2]
    return changed


def _one_turned(images: Float32, _: float) -> Float32:
    changed = images.copy()
    changed[len(images) // 3] = images[len(images) // 3, ::-1, ::-1]
    return changed


def _one_torn(images: Float32, part: float) -> Float32:
    """Replace rows in the middle of one image by those of another one."""
    changed, height = images.copy(), images.shape[1]
    first, last = (round(height * (0.5 + sign * part / 2)) for sign in (-1, 1))
    changed[len(images) // 3, first:last] = images[len(images) // 2, first:last]
    return changed


def _one_light_moved(places: Float64, degrees: float) -> Float64:
    """Turn one light toward the optical axis."""
    changed, one = places.copy(), len(places) // 3
    along = np.array([*places[one, :2], 0.0])
    axis = np.cross(along, [0.0, 0.0, 1.0])
    axis /= max(float(np.linalg.norm(axis)), 1e-9)
    turned, _ = cv2.Rodrigues(axis * np.radians(degrees))
    changed[one] = turned @ places[one]
    return changed


def _turned_about_z(places: Float64, degrees: float) -> Float64:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.asarray(places @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]))


def _tilted_about_y(places: Float64, degrees: float) -> Float64:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.asarray(places @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]))


def _across(r: Recording, part: float) -> Float64:
    x = _places(r.lights)[:, 0]
    return np.asarray(1 + part * x / np.abs(x).max())


def _scattered(r: Recording, part: float) -> Float64:
    return 1 + part * np.random.default_rng(_SCATTER_SEED).standard_normal(len(r.lights))


def _directions_only(r: Recording, _: float) -> Recording:
    lights = r.lights
    directions = Lights(directions=_places(lights), intensities=lights.intensities, ids=lights.ids)
    return replace(r, lights=directions)


def _distance(r: Recording, mm: float) -> Recording:
    if r.camera is None or r.camera.working_distance_mm is None:
        return r
    changed = replace(r.camera, working_distance_mm=r.camera.working_distance_mm + mm)
    return replace(r, camera=changed)


def _matrix(r: Recording, scale: float, shift: float) -> Recording:
    if r.camera is None:
        return r
    K = r.camera.K.copy()
    K[[0, 1], [0, 1]] *= scale
    K[0, 2] += shift * r.camera.width
    return replace(r, camera=replace(r.camera, K=K))


def _turned_images(rows: int, columns: int) -> Change:
    """Return a flip of the images, and of the truth and the mask, which are those in the images."""

    def changed(r: Recording, _: float) -> Recording:
        turn = (slice(None, None, rows), slice(None, None, columns))
        signs = np.array([columns, rows, 1], np.float32)
        return replace(
            r,
            images=np.ascontiguousarray(r.images[:, turn[0], turn[1]]),
            mask=np.ascontiguousarray(r.mask[turn]),
            normals=None if r.normals is None else r.normals[turn] * signs,
            height_mm=None if r.height_mm is None else r.height_mm[turn],
        )

    return changed


# Names of causes that are right, for several cases.
_AMBIENT, _BLACK = ("ambient-light",), ("black-level",)
_CURVE = ("transfer-curve", "transfer-curve-doubtful")
_TONE = ("tone-curve", *_CURVE)
_GAINS = ("light-brightness",)
_SHIFTS = ("image-shifted",)
_ORDER = ("lights-shuffled", "images-swapped", "lights-reversed", "lights-shifted-in-order")
_FLIPS = ("lights-mirrored", "lights-flipped", "images-turned", "image-turned")
_FRAME = ("lights-tilted", "lights-displaced", "lights-moved-together", "light-distance")
_GLOSS = ("surface-not-matte",)

NONE = "none"
CASES: dict[str, Case] = {
    NONE: Case("-", (0,), lambda r, _: r, ()),
    "room_light": Case("part of the mean image", (0.15, 0.05, 0.02), _with(_room_light), _AMBIENT),
    "room_light_changes": Case(
        "mean part of the mean image",
        (0.1, 0.05, 0.02),
        _with(_changing_room_light),
        ("ambient-light-changes", *_AMBIENT, *_GAINS),
    ),
    "black_offset": Case("of full scale", (0.02, 0.01, 0.04), _with(lambda v, s: v + s), _BLACK),
    "srgb_as_16bit": Case("-", (1,), _with(lambda v, _: _srgb(v), "tif16"), _CURVE, _GLOSS),
    "power": Case(
        "exponent",
        (1.2, 1.1, 1.5),
        _with(lambda v, s: np.clip(v, 0, 1) ** (1 / s)),
        _CURVE,
        _GLOSS,
    ),
    "jpeg": Case("-", (1,), _with(lambda v, _: _srgb(v), "jpg"), _CURVE, _GLOSS),
    "tone_curve": Case(
        "depth of the S", (0.06, 0.03, 0.1), _with(_tone_curve, "jpg"), _TONE, _GLOSS
    ),
    "local_tone": Case(
        "clip limit",
        (2.0, 1.2, 4.0),
        _with(_local_tone, "jpg"),
        ("local-tone-mapping", "residual-unexplained"),
    ),
    "clipped": Case(
        "part of the samples", (0.1, 0.03, 0.3), _with(_clipped), ("clipped-below-white", *_CURVE)
    ),
    "overexposed": Case(
        "times",
        (2.0, 1.5, 4.0),
        _with(lambda v, s: v * s, "png8"),
        ("frames-saturated", "samples-saturated"),
    ),
    "strengths_wrong": Case("standard deviation", (0.05, 0.02, 0.1), _states(_scattered), _GAINS),
    "strength_gradient": Case(
        "over half the board", (0.1, 0.05, 0.2), _states(_across), ("brightness-gradient", *_GAINS)
    ),
    "one_brighter": Case("part", (0.2, 0.1, -0.3), _with(_one_brighter), _GAINS),
    "fading": Case(
        "part from first to last", (0.1, 0.05, 0.2), _with(_fading), ("lights-fading", *_GAINS)
    ),
    "vignetting": Case("loss at half the width", (0.5, 0.2, 0.8), _with(_vignetted), ()),
    "distance_wrong": Case(
        "mm", (30, 10, -30), _distance, ("working-distance", *_FRAME), near=True
    ),
    "focal_wrong": Case(
        "part",
        (0.03, 0.01, 0.1),
        lambda r, s: _matrix(r, 1 + s, 0),
        ("focal-length", *_FRAME),
        near=True,
    ),
    "principal_point_wrong": Case(
        "of the width",
        (0.05, 0.02, 0.1),
        lambda r, s: _matrix(r, 1, s),
        ("principal-point", *_FRAME),
        near=True,
        hidden=("flat",),
    ),
    "lights_shifted": Case(
        "mm along x",
        (5, 2, 20),
        _placed(lambda p, s: p + np.array([s, 0, 0])),
        _FRAME,
        near=True,
        hidden=("flat",),
    ),
    "lights_turned": Case(
        "degrees about the optical axis",
        (5, 2, 15),
        _placed(_turned_about_z),
        ("lights-turned", *_FRAME),
    ),
    "lights_tilted": Case(
        "degrees about y", (3, 1, 8), _placed(_tilted_about_y), _FRAME, hidden=("flat", "distant")
    ),
    "lights_scaled": Case(
        "part", (0.03, 0.01, 0.1), _placed(lambda p, s: p * (1 + s)), _FRAME, near=True
    ),
    "lights_z_sign": Case("-", (1,), _signed(1, 1, -1), ("lights-reversed", *_FLIPS)),
    "lights_y_sign": Case("-", (1,), _signed(1, -1, 1), _FLIPS),
    "directions_only": Case("-", (1,), _directions_only, ("lights-not-distant",), near=True),
    "half_moved": Case(
        "px", (2, 1, 4), _with(_half_moved), ("images-moved", "images-drift", *_SHIFTS)
    ),
    "drift": Case(
        "px from first to last",
        (3, 1, 6),
        _with(_drift),
        ("images-drift", "images-moved", *_SHIFTS),
    ),
    "one_moved": Case("px", (2, 1, 4), _with(_one_moved), ("image-disagrees", *_SHIFTS)),
    "one_turned": Case("-", (1,), _with(_one_turned), ("image-turned", "image-disagrees")),
    "one_torn": Case(
        "part of the rows", (0.1, 0.05, 0.3), _with(_one_torn), ("image-striped", "image-disagrees")
    ),
    "one_repeated": Case("-", (1,), _with(_one_repeated), ("image-duplicate", "image-disagrees")),
    "one_light_moved": Case(
        "degrees",
        (25, 10, 5),
        _placed(_one_light_moved),
        ("light-moved", "image-disagrees", *_GAINS),
    ),
    "upside_down": Case("-", (1,), _turned_images(-1, -1), _FLIPS, hidden=("distant",)),
    "mirrored": Case("-", (1,), _turned_images(1, -1), _FLIPS),
    "swapped": Case("pairs of images", (1, 2, 3), _with(_swapped), _ORDER),
    "reversed": Case("-", (1,), _with(lambda v, _: v[::-1]), _ORDER),
    "shuffled": Case("-", (1,), _with(_shuffled), _ORDER),
    "order_shifted": Case("images", (1, 2, 5), _with(_rolled), _ORDER),
}
