"""Whether the colours of a recording determine its normals better than its gray images."""

from __future__ import annotations

import numpy as np

from acquisition import Lights, Source
from calibration.radiance import linear_images, luma
from processing.colour.channel_normals import ColourImages
from processing.colour.colour_albedo import coloured, may_have_colour
from processing.colour.joint_colours import law_of_joint_samples, solve_jointly
from processing.images.viewing_rays import SurfacePoints, View
from processing.noise.normal_errors import as_uncertainty, normal_uncertainty
from processing.noise.pixel_variances import SolvedStack
from processing.recording.colour_normals import shown_by_colours, variances_of_colours
from processing.stereo.method import Method
from processing.stereo.normals_and_albedo import photometric_stereo
from rig import Notice
from rig.arrays import Bool, Float32

# Images and rows that are compared.
_IMAGES, _ROWS = 24, 64
# Pixels below this share of the brightest hundredth are not those of the object.
_DARK = 0.1
# Fewest pixels that show how sure the normals are.
_FEWEST = 200
# Colours take four times as long as gray images: their deviation must be below this share.
_GAIN = 0.95


def choose_colours(
    source: Source, lights: Lights, view: View | None, method: Method
) -> Notice | None:
    """Return a notice if the predicted errors of normals are smaller with all colours, else None.

    Some rows of some images are solved in gray and from all colours (`solve_jointly`), with the
    law of the noise that each shows, and the medians of the standard deviations are compared.
    Frames of a mosaic stay gray: interpolation blurs red and blue the most.

    Parameters
    ----------
    source
        The recording.
    lights, view
        Its lights, and how pixels see points under near ones.
    method
        Method of `photometric_stereo`.
    """
    if source.cfa is not None or not may_have_colour(source):
        return None
    places = np.linspace(0, len(lights) - 1, min(len(lights), _IMAGES)).round().astype(int)
    ids = [source.light_ids[i] for i in places]
    height, width = source.size
    rows = _rows_of(source.mask, height)
    images: list[Float32] = []
    for image in linear_images(source, ids, channel="rgb"):
        if not images and not coloured(image):
            return None
        images.append(image[rows].copy())
    values = np.stack(images)
    given = None if view is None else SurfacePoints(view, view.distance_mm, (height, width))
    colours = ColourImages(
        values=values,
        lights=lights.take([*map(int, places)]),
        mask=_object_in(values, None if source.mask is None else source.mask[rows]),
        points_mm=None if given is None else given.of(rows),
        noise=None,
    )
    if np.count_nonzero(colours.mask) < _FEWEST:
        return None
    gray_deg, colours_deg = _deviation_in_gray(colours, method), _deviation(colours, method)
    if not colours_deg < _GAIN * gray_deg:
        return None
    text = (
        f"the normals are from all colours: their predicted error is {colours_deg:.2g} instead of "
        f"{gray_deg:.2g} degrees in gray"
    )
    return Notice("colours-used", text, severity="info")


def _rows_of(mask: Bool | None, height: int) -> slice:
    middle = height / 2 if mask is None or not mask.any() else np.nonzero(mask)[0].mean()
    first = int(np.clip(middle - _ROWS / 2, 0, max(height - _ROWS, 0)))
    return slice(first, min(first + _ROWS, height))


def _object_in(values: Float32, mask: Bool | None) -> Bool:
    """Return the pixels of a mask, or all, that show light in most images."""
    seen = np.median(np.nan_to_num(luma(values), nan=np.inf), axis=0)
    finite = seen[np.isfinite(seen)]
    lit = seen > _DARK * (np.quantile(finite, 0.99) if finite.size else np.inf)
    return np.ascontiguousarray(lit if mask is None else lit & mask)


def _deviation_in_gray(images: ColourImages, method: Method) -> float:
    values, points = luma(images.values), images.points_mm
    found = photometric_stereo(values, images.lights, images.mask, method=method, points_mm=points)
    bars = normal_uncertainty(values, images.lights, images.mask, found, points_mm=points)
    return _median(bars.sigma_deg)


def _deviation(images: ColourImages, method: Method) -> float:
    found = solve_jointly(images, method, law_of_joint_samples(images, method))
    solved = SolvedStack(
        values=images.values,
        lights=images.lights,
        mask=images.mask,
        normals=found.normals,
        albedo=found.albedo,
        points_mm=images.points_mm,
    )
    return _median(as_uncertainty(variances_of_colours(solved, shown_by_colours(solved))).sigma_deg)


def _median(sigma_deg: Float32) -> float:
    finite = sigma_deg[np.isfinite(sigma_deg)]
    return float(np.median(finite)) if finite.size else np.nan
