"""The outline of a sphere in ratio images, which show no print."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from calibration._errors import EstimateError
from calibration._spheres.ellipse import ELLIPSE_COVERAGE, Ellipse, fit_circle, fit_ellipse
from calibration._spheres.limb import REACH_PX, edge_costs, offsets_of, profile_offsets
from calibration._spheres.robust import Array
from calibration._spheres.spots import Values, reduced_image, without_nan

_LIGHTS = 16
_ALONG_PX = 3.0
_ROUNDS = 3
# The guess may be wrong by this share of the radius.
_GUESS_SHARE = 0.012
_BRIGHTEST = 3.0
_LEAST_GAIN = 0.15


def refine_in_ratios(values: Values, guess: Ellipse) -> tuple[Ellipse, Array, float]:
    """Refine an outline that is known to about 1 % of the radius.

    On a matte surface, the ratio of an image to the mean over the lights does not depend on the
    albedo, so print is invisible in it; the limb of a mirror is not. The edge at each angle is the
    position at which the model of a limb (`edge_costs`) best fits the ratios of all lights, and the
    mean. The noise of each ratio is unknown and differs, so the sum of the logarithms of
    the squared errors is minimised: a print edge in the mean spoils all positions alike.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    guess
        The approximate outline.

    Returns
    -------
    ellipse, points_px, coverage
        As for `refine_outline`.

    Raises
    ------
    EstimateError
        If there is no edge near the guess.
    """
    some = values[:: max(len(values) // _LIGHTS, 1)]
    outline = guess
    factor = max(int(_GUESS_SHARE * guess.radius_px / 0.7), 1)
    while factor > 1:
        outline, _, _ = _refined(some, outline, factor)
        factor //= 2
    return _refined(some, outline, 1)


def _refined(values: Values, guess: Ellipse, factor: int) -> tuple[Ellipse, Array, float]:
    """Refine at a resolution reduced by a factor."""
    centre, reach = np.array(guess.centre_px), max(guess.semi_axes_px) + (REACH_PX + 3) * factor
    low = np.maximum((centre - reach).astype(int), 0)
    high = np.minimum((centre + reach).astype(int) + 2, values.shape[:0:-1])
    size = np.maximum((high - low) // factor, 1)
    if np.any(high - low < 8):
        raise EstimateError(
            f"no sphere outline at ({centre[0]:.0f}, {centre[1]:.0f}) px: it is outside the images"
        )
    stack = []
    for image in values[:, low[1] : high[1], low[0] : high[0]]:
        part = without_nan(image)
        if factor > 1:
            part = reduced_image(part, (int(size[0]), int(size[1])), factor)
        stack.append(part)
    outline = _scaled(guess, low, factor)
    for _ in range(_ROUNDS):
        angles, offsets, seen = _edges(stack, outline)
        count = len(angles)
        if np.count_nonzero(seen) < 12:
            x, y = guess.centre_px
            raise EstimateError(
                f"no sphere outline at ({x:.0f}, {y:.0f}) px: give a mask or a better circle"
            )
        points = outline.point(angles[seen], 1 + offsets[seen] / outline.radius_px)
        outline, weights = fit_circle(points, outline)
        if len(points) > ELLIPSE_COVERAGE * count:
            outline, weights = fit_ellipse(points, outline)
    good = weights > 0
    full = (points[good] + 0.5) * factor - 0.5 + low
    return _unscaled(outline, low, factor), full, float(np.count_nonzero(good)) / count


def _edges(stack: list[Values], outline: Ellipse) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Return angles, the offset of the edge at each, and where there is one."""
    count = int(np.clip(2 * np.pi * outline.radius_px, 90, 1000))
    angles = np.arange(count, dtype=np.float64) * (2 * np.pi / count)
    across = profile_offsets()
    place = outline.point(angles[:, None], 1 + across[None, :] / outline.radius_px)
    x, y = (np.ascontiguousarray(place[..., axis], np.float32) for axis in (0, 1))
    sampled = np.array(
        [cv2.remap(i, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for i in stack],
        np.float64,
    )
    height, width = stack[0].shape
    inside = np.all((x > 0) & (y > 0) & (x < width - 1) & (y < height - 1), axis=1)
    mean = np.median(sampled, axis=0)
    floor = max(1e-3 * float(mean.max()), 1e-9)
    limited = np.minimum(sampled, _BRIGHTEST * mean)
    if len(stack) > 2:
        mean = limited.mean(axis=0)
        channels = [*(limited / (mean + floor)), np.log(mean + floor)]
    else:
        channels = list(np.log(np.maximum(limited, 0) + floor))
    smooth = [gaussian_filter1d(c, _ALONG_PX, axis=0, mode="wrap") for c in channels]
    total = _costs(smooth)
    gain = np.median(total, axis=1) - total.min(axis=1)
    return angles, offsets_of(total), inside & (gain > _LEAST_GAIN)


def _costs(channels: list[Array]) -> Array:
    """Return the mean over the channels of the logarithms of the squared errors."""
    errors = [edge_costs(channel) for channel in channels]
    costs: Array = np.mean([np.log(e + 0.05 * np.median(e) + 1e-12) for e in errors], axis=0)
    return costs


def _scaled(outline: Ellipse, low: npt.NDArray[np.int_], factor: int) -> Ellipse:
    x, y = (np.array(outline.centre_px) - low + 0.5) / factor - 0.5
    a, b = outline.semi_axes_px
    return Ellipse((float(x), float(y)), (a / factor, b / factor), outline.angle_deg)


def _unscaled(outline: Ellipse, low: npt.NDArray[np.int_], factor: int) -> Ellipse:
    x, y = (np.array(outline.centre_px) + 0.5) * factor - 0.5 + low
    a, b = outline.semi_axes_px
    return Ellipse((float(x), float(y)), (a * factor, b * factor), outline.angle_deg)
