"""Which images, lights and heights are used for the normals, and how well they agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from acquisition import Lights, Source
from acquisition.source import setup_notices
from calibration import EstimateError, Stack
from processing.checks import limits
from processing.checks.quality import Examined, ImageQuality, quality_of
from processing.checks.verdict import Verdict
from processing.images.mosaic import blocks_of_sites
from processing.images.recorded_images import Images, RecordedImages, RowSample
from processing.images.viewing_rays import (
    Parallel,
    SurfacePoints,
    View,
    lights_of,
    middle_mm,
    view_of,
)
from processing.maps.mask import mask_of_images
from processing.near.mean_height_search import HeightWithStrengths
from processing.near.near_height import Heights, NearHeight, height_limits
from processing.recording.repairs import Repairs, repairs_of
from processing.series.ambient_light import AmbientLight, find_ambient_light
from processing.series.interreflection import find_interreflection
from processing.series.light_distance import LightDistance, find_light_distance
from processing.series.strengths import (
    LightStrengths,
    light_strengths,
    of_source,
    with_strengths,
)
from processing.stereo.frames import Frames
from processing.stereo.light_model import LightModel
from processing.stereo.method import Method
from processing.stereo.solve import solve_maps
from processing.stereo.stereo_maps import StereoMaps
from rig import Notice, Progress, Severity, no_progress
from rig.arrays import Bool, Float32, Float64, Intp

# A computed mask beyond these probably contains background.
_LARGEST_SHARE = 0.8
_MOST_BORDERS = 3
# So many images show whether a mask is inverted: then so much of what stands out in them or is
# outside the mask is both.
_SOME, _INVERTED = 4, 0.5
# A contrast above which a computed mask is hardly wrong; `object_mask` requires 3.
_CLEAR = 10.0
# An image shows no light if its brightest parts are below this fraction of those of the others. If
# the others are below this fraction of its brightest parts, the strength of its light is wrong.
_BLACK = 0.02
_THREADS = 2
# Pixels of the object, spread over it, whose brightness counts.
_PIXELS = 100_000
# Most rounds of strengths and height, and the change of the height at which they end.
_ROUNDS, _STATED_ROUNDS = 5, 2
_SETTLED_MM = 0.5
# A larger one in the last round is refused.
_UNSETTLED_MM = 5.0
# Notices about the height that say that images and lights contradict each other.
_CAUSES = ("height-contradicted", "height-doubtful")
# Relative error of strengths by that of a height that is found with them: on simulated objects it
# is 0.05 to 1.2 %, and ten times what residuals show; on four that are not matte, 3 to 9 %.
_BY_HEIGHT, _BY_GLOSSY_HEIGHT = 0.01, 0.07


# Distance of lights that have only directions, mm.
DistanceChoice = float | Literal["estimate"] | None


class Geometry(NamedTuple):
    """Lights to use, how pixels see points under near ones, and what is known of the height."""

    lights: Lights
    view: View | None
    height_mm: float | None
    rests_on_plane: bool


def examination_of(
    source: Source,
    stack: Stack,
    geometry: Geometry,
    method: Method,
    on_progress: Progress,
) -> tuple[Examination, list[Notice]]:
    """Return the examination of the images of a source, and notices about the mask.

    Raises
    ------
    EstimateError
        If no object stands out.
    """
    lights, view, height_mm, rests_on_plane = geometry
    images = RecordedImages(stack)
    on_progress("normals", 0, 1)  # the images are examined first
    mask, of_mask = _object_of(images, stack.mask, source.not_object, stack.pattern)
    heights = Heights(view, mask, height_mm, rests_on_plane, method, on_progress)
    points = None if view is None else SurfacePoints(view, view.distance_mm, mask.shape)
    return Examination(source, images, lights, mask, heights, points), of_mask


def geometry_of(
    source: Source,
    pixel_mm: float | None,
    height_mm: float | None,
    *,
    rests_on_plane: bool,
    distant: bool,
    light_distance_mm: DistanceChoice = None,
) -> Geometry:
    """Return the geometry of a source, before any image is read.

    Raises
    ------
    DataError
        If there are no lights, or near lights have no scale.
    """
    lights, view = lights_of(source, distant=distant), None
    if light_distance_mm is not None:
        view = view_of(source, pixel_mm)
        if light_distance_mm != "estimate":
            lights = lights.at_distance(light_distance_mm, middle_mm(source, view))
    elif lights.near:
        view = view_of(source, pixel_mm)
    return Geometry(lights, view, height_mm, rests_on_plane)


def check_facing(source: Source, mean_z: float) -> None:
    """Raise `EstimateError` if most normals face away from the camera."""
    if mean_z < 0:
        raise EstimateError(
            f"{source.path}: the normals face away from the camera: check that the light "
            "directions point from the object toward the lights, with z toward the camera"
        )


def _object_of(
    images: RecordedImages, mask: Bool | None, elsewhere: Bool | None, pattern: str | None
) -> tuple[Bool, list[Notice]]:
    """Return the mask of the object, computed from the images if no mask is given, and notices.

    Parameters
    ----------
    images
        The N images.
    mask
        ``(H, W)`` bool, the mask of the source; None if it has no mask.
    elsewhere
        ``(H, W)`` bool, pixels that are something else, such as spheres; None without any.
    pattern
        Colours of the first 2 x 2 sites of a mosaic; None for other images.

    Raises
    ------
    EstimateError
        If no object stands out.
    """
    if mask is not None:
        return mask if elsewhere is None else mask & ~elsewhere, []
    seen = images if pattern is None else map(blocks_of_sites, images)
    computed = mask_of_images(seen, images.size, elsewhere)
    text = (
        "the images have no mask: one was computed; the object is "
        f"{computed.contrast:.0f} times as bright as the background"
    )
    doubt: Severity = "info" if computed.contrast > _CLEAR else "warning"
    notice = Notice("mask-estimated", text, severity=doubt)
    return computed.mask, [notice, *_mask_warning(computed.mask)]


def _mask_warning(mask: Bool) -> list[Notice]:
    """Return a warning about a computed mask that probably contains background."""
    share, touched = float(mask.mean()), _touched(mask)
    if share <= _LARGEST_SHARE and touched < _MOST_BORDERS:
        return []
    text = (
        f"the computed mask covers {share:.0%} of the image and touches {touched} of its borders: "
        "it probably contains background; give a mask"
    )
    return [Notice("mask-fills-frame", text)]


def _touched(mask: Bool) -> int:
    """Return how many borders of the image a mask touches."""
    return sum(bool(border.any()) for border in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))


def inverted_mask(images: Images, mask: Bool, elsewhere: Bool | None) -> list[Notice]:
    """Return a doubt about a mask around what stands out in the images.

    Parameters
    ----------
    images
        N images ``(H, W)``, of which some are read.
    mask
        ``(H, W)`` bool.
    elsewhere
        ``(H, W)`` bool, pixels that are neither object nor background; None without any.
    """
    if _touched(mask) < _MOST_BORDERS:
        return []
    some = [images[i] for i in range(0, len(images), -(-len(images) // _SOME))]
    try:
        object_ = mask_of_images(some, mask.shape, elsewhere)
    except EstimateError:
        return []
    outside = ~mask if elsewhere is None else ~(mask | elsewhere)
    common, both = outside & object_.mask, outside | object_.mask
    if np.count_nonzero(common) <= _INVERTED * np.count_nonzero(both):
        return []
    text = (
        "what is outside the mask is an object "
        f"{object_.contrast:.0f} times as bright as what is inside: the mask is probably inverted; "
        "exchange black and white in the mask"
    )
    return [Notice("mask-inverted", text)]


class Examination:
    """The images of an object while it is decided with what the normals are computed.

    It has the only references to the images, so that replaced ones are released.

    Parameters
    ----------
    source
        The recording.
    images
        Its N images.
    lights
        The N lights.
    mask
        ``(H, W)`` bool, the object.
    heights
        Finds the points of the surface.
    points
        Points in the working plane; None under distant lights.
    """

    def __init__(
        self,
        source: Source,
        images: RecordedImages,
        lights: Lights,
        mask: Bool,
        heights: Heights,
        points: SurfacePoints | None,
    ) -> None:
        self.source = source
        self.images = images
        self.lights = lights
        self.points = points
        self.near: NearHeight | None = None
        self.strengths: LightStrengths | None = None
        self.light_distance: LightDistance | None = None
        self.ambient: AmbientLight | None = None
        self.excluded: tuple[str, ...] = ()
        self.rescaled: dict[str, float] = {}
        self.warnings: list[Notice] = []
        self._doubts: list[Notice] = []
        self.mask = mask
        self._heights = heights
        self.view = heights.view

    def leave_out_unlit(self) -> None:
        """Leave out images without light on the object."""
        lit, ids = lit_images(self.images, self.mask), self.images.ids
        if len(lit) < len(ids):
            self.warnings += _unlit_notices(self.images, self.mask, ids, lit)
            self._take(lit)

    def find_light_distance(self, view: View) -> None:
        """Find the distance of lights that have only directions."""
        middle = middle_mm(self.source, view)
        found = find_light_distance(self.images, self.lights, self.mask, view, middle)
        near = found.lights(lights_of(self.source, distant=False), middle)
        self.source, self.light_distance = replace(self.source, lights=near), found
        self.warnings += found.warnings
        self.lights = near.take([near.ids.index(name) for name in self.lights.ids])

    def find_ambient(self) -> None:
        """Find a constant light, and subtract it from the images."""
        shape = self.mask.shape
        view = self.view
        if view is None:  # the shape does not matter under distant lights
            view = Parallel(1.0, shape, ((shape[1] - 1) / 2, (shape[0] - 1) / 2))
        if not self.images.in_colour:
            self.ambient = find_ambient_light(self.images, self.lights, self.mask, view)
            constant = self._constant(self.ambient, self.images)
        else:
            stack, kinds, parts = self.images.stack(colour=True), [], []
            for channel in range(stack.values.shape[-1]):
                values = np.ascontiguousarray(stack.values[..., channel])
                one = RecordedImages(replace(stack, values=values, noise=None))
                strength = np.asarray(self.lights.intensities)[:, channel]
                lights = replace(self.lights, intensities=strength)
                kinds.append(find_ambient_light(one, lights, self.mask, view))
                parts.append(self._constant(kinds[-1], one))
            constant = np.stack(parts, axis=-1)
            self.ambient = kinds[1]  # green has the largest part of the gray images
        self.images = self.images.without(constant, self.ambient.shares)

    def _constant(self, ambient: AmbientLight, images: RecordedImages) -> Float32:
        """Return the constant light ``(H, W)``; the second time, it is no longer in the images."""
        constant = np.zeros(self.mask.shape, np.float32)
        points = None
        if self.view is not None and self.lights.near:
            depth = self.view.distance_mm - ambient.mean_height_mm
            points = SurfacePoints(self.view, float(depth), self.mask.shape)
        for light in (ambient.seen_with, ambient.seen):
            found = np.zeros_like(constant)
            for band in images.without(constant, ambient.shares).bands(self.mask, 0):
                of_band, maps = band.sample, StereoMaps.empty(band.sample.mask.shape)
                model = LightModel(self.lights, of_band.of(points), of_band.mask)
                frames = Frames(of_band.values)
                solve_maps(frames, model, of_band.mask, None, "cauchy", maps, None, no_progress)
                found[band.rows] = light(maps.normals, maps.albedo)
            constant = found
        return constant

    def find_surface(self, *, semi_calibrated: bool) -> None:
        """Find the points of the surface, and the strengths of the lights if they are not known."""
        strengths = self._divided() if semi_calibrated else None
        if strengths is None or self.view is None:
            self._find_height()
        else:
            strengths = self._near_strengths(strengths, self.view)
        if strengths is None:
            return
        self.lights = strengths.lights
        given = with_strengths(self.source.lights, self.lights)
        self.source = replace(self.source, lights=given)
        self.strengths = strengths if given is None else of_source(strengths, given)
        self.warnings += self.strengths.warnings

    def check(self, *, exclude_disagreeing: bool) -> ImageQuality:
        """Test whether images, lights and normals agree; repair or leave out images that do not."""
        quality = self._quality()
        if exclude_disagreeing:
            repairs, ids = _repairs(quality), self.lights.ids
            if repairs.factors:
                repairs = self._rescaled(repairs)
            self.warnings += repairs.notices()
            self.excluded, self.rescaled = repairs.left_out, dict(repairs.factors)
            if self.excluded:
                self._take(repairs.kept(ids))
            if self.excluded or self.rescaled:
                self._find_height()
                quality = self._quality()
        for notice in () if self.near is None else self.near.warnings:
            (self._doubts if notice.code in _CAUSES else self.warnings).append(notice)
        return quality

    def subtract_reflected(self, method: Method) -> None:
        """Subtract the light that the object reflects onto itself, if its shadows show it."""
        view, shape = self.view, self.mask.shape
        if view is None:  # the size does not matter under distant lights
            view = Parallel(1.0, shape, ((shape[1] - 1) / 2, (shape[0] - 1) / 2))
        depth = None if self.near is None else self.near.depth
        found = find_interreflection(self.images, self.lights, self.mask, view, depth, method)
        if found.light is not None:
            self.images = self.images.without_reflected(found.light)
        self.warnings.append(found.notice)

    def verdict(self, quality: ImageQuality, sigma_deg: float) -> Verdict:
        """Return what is probably wrong; ``sigma_deg`` is stated of the normals, the median."""
        of_mask = inverted_mask(self.images, self.mask, self.source.not_object)
        doubts = [*setup_notices(self.source), *self._doubts, *of_mask, *self._saturated()]
        return quality.verdict(sigma_deg, doubts)

    def _saturated(self) -> list[Notice]:
        sample = self.sample()
        share = float(np.isnan(sample.values[:, sample.mask]).mean())
        text = (
            f"{share:.0%} of the samples of the object are saturated; record with shorter exposure "
            "times, or add a shorter bracket"
        )
        return [Notice("samples-saturated", text)] if share > limits.SATURATED else []

    def sample(self) -> RowSample:
        """Return some rows of the images."""
        return self.images.sample(self.mask)

    def _take(self, kept: Sequence[int]) -> None:
        self.images, self.lights = self.images.take(kept), self.lights.take(list(kept))

    def _rescaled(self, repairs: Repairs) -> Repairs:
        """Divide images by the strengths that they show; return the repairs with these factors.

        If some strengths are not as stated, those of all lights are fitted, so that they agree.
        """
        ids = self.lights.ids
        sample, kept, factors = self.sample(), repairs.kept(ids), repairs.scales(ids)
        right = np.array([ids[i] not in repairs.factors for i in kept])
        try:
            found = light_strengths(
                sample.values[kept],
                self.lights.take(kept),
                sample.mask,
                points_mm=sample.of(self.points),
            )
        except EstimateError:
            pass  # only the images that are far off
        else:
            reference = right if right.any() else np.ones_like(right)
            factors[kept] = found.factors / np.median(found.factors[reference])
            pairs = zip(ids, factors.tolist(), strict=True)
            named = {name: factor for name, factor in pairs if name in repairs.factors}
            repairs = replace(repairs, factors=named)
        self.images = self.images.divided(factors)
        intensities = np.asarray(self.lights.intensities) * factors[:, None]
        self.lights = replace(self.lights, intensities=intensities)
        given = with_strengths(self.source.lights, self.lights)
        self.source = replace(self.source, lights=given)
        return repairs

    def _divided(self) -> LightStrengths:
        """Divide the images by the strengths that they show."""
        gray = self.images.stack()
        points_mm = None if self.points is None else self.points.of()
        found = light_strengths(gray.values, self.lights, self.mask, points_mm=points_mm)
        del gray
        self.images = RecordedImages(found.divided(self.images.stack(colour=True)))
        return found

    def _near_strengths(self, strengths: LightStrengths, view: View) -> LightStrengths:
        """Find strengths, mean height and shape in turn: they depend on each other."""
        heights, found = self._heights, None
        search = None
        if not heights.stated:
            limits = height_limits(self.lights, view)
            search = HeightWithStrengths(self.images, self.lights, self.mask, view, limits)
        depth = np.full(self.mask.shape, view.distance_mm - (heights.height_mm or 0.0), np.float32)
        for _ in range(_STATED_ROUNDS if search is None else _ROUNDS):
            before = found
            if search is not None:
                found = search.best(depth, before)
                if found is None:
                    self._find_height()
                    break
                shape, mean = depth.astype(np.float64), float(depth[self.mask].mean())
                depth = view.moved(shape, mean, view.distance_mm - found).astype(np.float32)
                self._heights = replace(heights, height_mm=found)
            self.points = SurfacePoints(view, depth, self.mask.shape)
            strengths = strengths.refined(self._divided())
            self._find_height()
            change = math.inf if before is None or found is None else abs(found - before)
            if self.near is None or change < _SETTLED_MM:
                break
            depth = self.near.depth
        else:
            if search is not None and change > _UNSETTLED_MM:
                raise EstimateError(
                    "the images do not determine the strengths of the lights together with the "
                    "height of the object: state the height, use an object with more relief, or "
                    "calibrate the strengths"
                )
        if search is None:
            return strengths
        glossy = any(notice.code == "strengths-not-matte" for notice in strengths.warnings)
        return strengths.less_certain(_BY_GLOSSY_HEIGHT if glossy else _BY_HEIGHT)

    def _find_height(self) -> None:
        self.near, self.points = self._heights.of(self.images, self.lights)

    def _quality(self) -> ImageQuality:
        camera, source = self.source.camera, self.source
        pixel_mm = getattr(self.view, "pixel_mm", None)
        if camera is not None and camera.working_distance_mm is not None:
            pixel_mm = camera.working_distance_mm / float(camera.K[0, 0])
        certain = not np.isfinite(source.white_level)
        return quality_of(
            Examined(
                self.images,
                self.lights,
                self.mask,
                self.points,
                self.view,
                _strengths(source, self.lights),
                pixel_mm,
                None if certain else source.transfer,
            )
        )


def _strengths(source: Source, lights: Lights) -> Float64:
    """Return the recorded signal of each image, where white is 1, relative to its samples."""
    exposures = dict.fromkeys(source.light_ids, 0.0)
    for frame in source.frames:
        if frame.role == "light" and frame.light_id in exposures:
            exposures[frame.light_id] = max(exposures[frame.light_id], frame.exposure_us or 0.0)
    longest = max(exposures.values()) or 1.0
    times = np.array([(exposures[name] or longest) / longest for name in lights.ids])
    return np.asarray(times * np.asarray(lights.intensities).mean(axis=1))


def _repairs(quality: ImageQuality) -> Repairs:
    wrong = quality.explanation.disagreeing
    reasons = "; ".join(
        cause.text for cause in quality.causes if set(cause.where.split(", ")) & wrong.keys()
    )
    return repairs_of(wrong, reasons)


def lit_images(values: Images, mask: Bool) -> list[int]:
    """Return the indices of the images with light on the object.

    The other images are black, because of a dead LED or a lost trigger, or so much brighter than
    the others that the strength of their light is wrong.

    Parameters
    ----------
    values
        N images ``(H, W)`` of linear radiance; samples that are not finite are saturated.
    mask
        ``(H, W)`` bool, the object.
    """
    pixels = _spread(mask)
    with ThreadPoolExecutor(_THREADS) as pool:
        bright = np.array(
            list(pool.map(lambda i: _brightness(values[i], pixels), range(len(values))))
        )
    usual = np.median(bright)
    return [int(i) for i in np.flatnonzero((bright > _BLACK * usual) & (_BLACK * bright < usual))]


def _unlit_notices(values: Images, mask: Bool, ids: Sequence[str], lit: list[int]) -> list[Notice]:
    """Return warnings about the images that `lit_images` left out.

    Noise makes some samples of a black image negative. An image most of whose samples are below
    zero by more than that is no image of light: more was subtracted than recorded.
    """
    out = [i for i in range(len(values)) if i not in lit]
    pixels = _spread(mask)
    usual = float(np.median([_brightness(values[i], pixels) for i in lit]))
    bright = [i for i in out if _brightness(values[i], pixels) > usual]
    negative = [i for i in out if np.nanmedian(values[i][mask]) < -_BLACK * usual]
    dark = [i for i in out if i not in (*negative, *bright)]
    reasons = {
        "images left out because they show no light": dark,
        f"images left out because they are more than {1 / _BLACK:.0f} times as bright as the "
        "others (check the strengths of their lights)": bright,
        "images left out because most of their samples are negative (check what was subtracted)": (
            negative
        ),
    }
    return [
        Notice("lights-unlit", f"{text}: {', '.join(ids[i] for i in some)}")
        for text, some in reasons.items()
        if some
    ]


def _spread(mask: Bool) -> Intp:
    """Return flat indices of pixels of the object, at most `_PIXELS`."""
    inside = np.flatnonzero(mask)
    if len(inside) <= _PIXELS:
        return inside
    return inside[np.linspace(0, len(inside) - 1, _PIXELS).astype(np.intp)]


def _brightness(image: Float32, pixels: Intp) -> np.float32:
    inside = np.nan_to_num(image.reshape(-1)[pixels], copy=False, nan=1.0)
    return np.float32(np.quantile(inside, 0.99, overwrite_input=True))
