"""Centres of highlights, with standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from rig.arrays import Bool, Float32, Float64

# Levels of the two contours of a saturated highlight, relative to white. Pixels bias the first one
# more, glare the second one.
_LEVELS = (0.85, 0.6)
# Standard deviation of a coordinate by the positions of the pixels, times the radius of the core.
PIXELS_PX2 = (0.134, 0.085)
# Error by glare, from the shift between the levels beyond its noise: at most six times the shift
# (weak glare moves both) and at most a quarter of it plus 0.02 of the radius (strong glare moves
# the lower one far).
_WEAK_GLARE, _STRONG_GLARE, _GLARE_RADII = 6.0, 0.25, 0.02
# The centre moves further by this share of the motion from the lower level to the upper one.
_BEYOND, _LONGEST_RADII = 0.3, 0.1
# A core of more than so many pixels is mostly stray light, which is not centred on the light: error
# as a share of what the radius exceeds this by, times d log radius / d log level, and as a share of
# the elongation beyond that of a core near the limb of a ball, which a wide ray may cause.
_LARGE_PX, _OF_HALO, _OF_ELONGATION, _ELONGATED = 8.0, 0.1, 0.5, 0.15
_STEP_PX = 0.25
# Protruding distances are rays. The start ignores the upper part of the distances.
_START_QUANTILE = 0.35
_ROUNDS = 12
_TUKEY = 4.685
_FINEST_SCATTER_PX = 0.08
# What is stated for a sharp, unsaturated peak without noise, whose photons are not known.
PEAK_SIGMA_PX = 0.01
_WIDER = 1.5


@dataclass(frozen=True)
class Spot:
    """The centre of a highlight.

    Parameters
    ----------
    centre
        (x, y) in pixels.
    sigma_px
        Standard deviation of each coordinate.
    radius_px
        Radius of the contour of a saturated one, without rays; NaN for others.
    photon_px2
        Variance of each coordinate by photon noise, if one photon had the brightness 1; NaN for a
        saturated one.
    stray_px
        Further standard deviation of each coordinate by stray light, which makes a core large. It
        does not say which of several spots is the highlight.
    """

    centre: Float64
    sigma_px: float
    radius_px: float = float("nan")
    photon_px2: float = float("nan")
    stray_px: float = 0.0


def saturated_spot(image: Float32, region: Bool, white: float) -> Spot:
    """Locate a saturated highlight by the contours of its core.

    Rays and glare add light, so they move the contour outward. The distances r(t) of the contour
    from the centre are fitted with ``r0 + a cos t + b sin t + c cos 2t + d sin 2t``: a and b move
    the centre, c and d admit an elliptic core. The fit starts at the lower distances (quantile
    regression) and gives no weight to those that protrude (Tukey's biweight). The result is the
    mean of the contours at 0.85 and 0.6 of white, weighted by their variances; that of the lower
    one includes its distance from the upper one. The part of this distance that is not noise is
    glare; 0.3 of it is added beyond the upper contour.

    Parameters
    ----------
    image
        ``(H, W)`` without background; at least ``white`` where saturated.
    region
        ``(H, W)`` pixels of the highlight.
    white
        Smallest brightness of saturated pixels.
    """
    upper, radius, variance, elongation = _contour_fit(image, region, _LEVELS[0] * white)
    lower, lower_radius, wider, _ = _contour_fit(image, region, _LEVELS[1] * white)
    moved = lower - upper
    shift = float(np.linalg.norm(moved)) / np.sqrt(2)
    variance += (PIXELS_PX2[0] / max(radius, 0.5)) ** 2
    wider += (PIXELS_PX2[1] / max(radius, 0.5)) ** 2
    noise = variance + wider
    shown = shift**3 / (shift**2 + noise)
    glare = min(_WEAK_GLARE * shown, _STRONG_GLARE * shown + _GLARE_RADII * radius)
    wider += shown**2
    share = variance / (variance + wider)
    # Beyond its noise, the motion between the levels is that of glare, which also acts above it.
    beyond = _BEYOND * max(1 - noise / max(shift**2, 1e-12), 0.0)
    beyond *= min(1.0, _LONGEST_RADII * radius / max(beyond * float(np.linalg.norm(moved)), 1e-12))
    # The errors of the two contours are alike: their mean is not better than the better one.
    total = min(variance, wider) + glare**2
    return Spot(
        upper + (share - beyond) * moved,
        float(np.sqrt(total)),
        radius,
        stray_px=_stray_px(radius, lower_radius, elongation),
    )


def _stray_px(radius: float, lower_radius: float, elongation: float) -> float:
    """Return the error of a large core: a halo is soft, and a wide ray makes it long.

    Two photographed balls at four brightnesses, with cores of 15 to 45 px, have errors of 1 to 2 px
    by their halos, and of 4 to 8 px by rays as wide as the core.
    """
    excess = max(radius - _LARGE_PX, 0.0)
    softness = np.log(max(lower_radius / radius, 1.0)) / np.log(_LEVELS[0] / _LEVELS[1])
    return excess * float(
        np.hypot(_OF_HALO * softness, _OF_ELONGATION * max(elongation - _ELONGATED, 0.0))
    )


def unsaturated_spot(image: Float32, region: Bool, noise: float) -> Spot:
    """Locate an unsaturated highlight by its Gaussian-weighted centroid.

    The standard deviation contains the noise in the window, the shift of the centroid in a window
    that is wider by half (glare, a skew spot), and 0.01 px.

    Parameters
    ----------
    image
        ``(H, W)`` without background.
    region
        ``(H, W)`` pixels of the highlight above 0.3 of its height.
    noise
        Standard deviation of the noise of a pixel.
    """
    sigma = np.sqrt(np.count_nonzero(region) / np.pi)
    centre, flux, photon_px2 = weighted_centroid(image, region, sigma)
    wide, *_ = weighted_centroid(image, region, _WIDER * sigma)
    # The variance of twice the sum of g x n, g the Gaussian window, divided by that of g I.
    of_noise = 4 * noise**2 * (np.pi / 8) * sigma**4 / max(flux, 1e-12) ** 2
    shift = 0.5 * float(np.sum((centre - wide) ** 2))
    sigma_px = float(np.sqrt(of_noise + shift + PEAK_SIGMA_PX**2))
    return Spot(centre, sigma_px, photon_px2=photon_px2)


def weighted_centroid(image: Float32, region: Bool, sigma: float) -> tuple[Float64, float, float]:
    """Return the iterated Gaussian-weighted centroid (SExtractor's XWIN), and its weighted flux.

    The window follows the spot, so the positions of the pixels do not bias a symmetric spot, and
    noise in its wings and its neighbours have little weight. The third value is the variance of a
    coordinate by photon noise, if the variance of each pixel is its brightness.
    """
    y, x = np.nonzero(region)
    weight = np.clip(image[y, x].astype(np.float64), 1e-12, None)
    centre = np.array([np.average(x, weights=weight), np.average(y, weights=weight)])
    half = int(5 * sigma)
    top, left = max(int(y.mean()) - half, 0), max(int(x.mean()) - half, 0)
    window = image[top : int(y.mean()) + half + 1, left : int(x.mean()) + half + 1]
    rows, columns = np.indices(window.shape) + np.array([top, left])[:, None, None]
    # More than half of the window is background.
    excess = window.astype(np.float64) - np.median(window)
    total = 0.0
    for _ in range(60):
        gauss = np.exp(-((columns - centre[0]) ** 2 + (rows - centre[1]) ** 2) / (2 * sigma**2))
        total = float(np.sum(gauss * excess))
        if not total > 0:
            break
        offset = np.array([np.sum(gauss * excess * columns), np.sum(gauss * excess * rows)])
        # Double the shift: the window moves the weighted mean half-way back to its own centre.
        shift = 2 * (offset / total - centre)
        centre = centre + shift
        if np.hypot(*shift) < 1e-5:
            break
    # One coordinate has half of the square. The window follows the centre, which divides the shift
    # by less than the flux.
    square = ((columns - centre[0]) ** 2 + (rows - centre[1]) ** 2) / 2
    noise = float(np.sum(gauss**2 * np.maximum(excess, 0) * square))
    slope = float(np.sum(gauss * excess * (1 - square / sigma**2)))
    return centre, total, noise / max(slope, 1e-12) ** 2


def _contour_fit(image: Float32, region: Bool, level: float) -> tuple[Float64, float, float, float]:
    """Return the contour at a level: centre, radius, variance of a coordinate and elongation.

    The elongation is half of the difference of the axes, as a share of the radius.
    """
    centre, radius = largest_disc((image >= level) & region)
    centre = np.asarray(centre, np.float64)
    for _ in range(4):
        count = int(np.clip(2 * np.pi * radius / 0.75, 24, 240))
        angles = np.arange(count, dtype=np.float64) * (2 * np.pi / count)
        toward = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        reach = 3 * radius + 4
        distances = _distances(image, centre, toward, level, reach)
        if distances.min() >= reach - _STEP_PX:
            # It is as bright all around, so there is no contour at this level.
            return centre, float(radius), float(reach**2), 0.0
        fit = _RobustHarmonics(angles, distances)
        radius, *shift = fit.harmonics[:3]
        radius = max(radius, 0.5)
        shift = np.array(shift) * min(1.0, radius / max(float(np.hypot(*shift)), 1e-9))
        centre = centre + shift
        if np.hypot(*shift) < 1e-3:
            break
    elongation = float(np.hypot(*fit.harmonics[3:])) / radius
    return centre, float(radius), fit.variance, elongation


def largest_disc(core: Bool) -> tuple[Float64, float]:
    """Return centre and radius of the largest disc inside a core."""
    whole = core.astype(np.uint8)
    left, top, width, height = cv2.boundingRect(whole)
    padded = np.pad(whole[top : top + height, left : left + width], 1)
    depth = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    y, x = np.nonzero(depth >= depth.max() - 0.01)
    # Several equally deep pixels: the one nearest to their mean is in the core.
    nearest = int(np.argmin((x - x.mean()) ** 2 + (y - y.mean()) ** 2))
    centre = np.array([x[nearest] + left - 1, y[nearest] + top - 1], np.float64)
    return centre, max(float(depth.max()) - 0.5, 0.5)


def _distances(
    image: Float32, centre: Float64, toward: Float64, level: float, reach: float
) -> Float64:
    """Return the distances at which the brightness along the rays falls below the level."""
    radii = np.arange(0, reach, _STEP_PX)
    places = (centre + radii[None, :, None] * toward[:, None]).astype(np.float32)
    profiles = cv2.remap(
        image, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float64)
    below = profiles < level
    below[:, -1] = True
    first = np.maximum(np.argmax(below, axis=1), 1)
    rows = np.arange(len(toward))
    before, after = profiles[rows, first - 1], profiles[rows, first]
    part = np.clip((before - level) / np.maximum(before - after, 1e-12), 0, 1)
    return np.asarray(radii[first - 1] + part * _STEP_PX)


class _RobustHarmonics:
    """The low harmonics (r0, a, b, c, d) of the lower ones of some distances."""

    def __init__(self, angles: Float64, distances: Float64) -> None:
        twice = 2 * angles
        waves = [np.cos(angles), np.sin(angles), np.cos(twice), np.sin(twice)]
        self._design: Float64 = np.stack([np.ones_like(angles), *waves])
        self._weights = np.ones_like(angles)
        for round_ in range(_ROUNDS):
            weighted = self._design * self._weights
            # A little ridge: few weights may be left on one side. For so few equations, OpenCV is
            # faster than NumPy.
            normal = weighted @ self._design.T + 1e-6 * np.eye(len(weighted))
            solution = cv2.solve(normal, weighted @ distances[:, None])[1]
            self.harmonics = np.asarray(solution[:, 0], np.float64)
            self._residual = distances - self.harmonics @ self._design
            if round_ < _ROUNDS // 2:
                side = np.where(self._residual > 0, _START_QUANTILE, 1 - _START_QUANTILE)
                self._weights = side / np.maximum(np.abs(self._residual), 0.05)
            else:
                low = np.sort(np.abs(self._residual[self._residual <= 0]))
                if not len(low):
                    break  # the distances are equal, and the ridge makes all fitted ones less
                middle = (low[(len(low) - 1) // 2] + low[len(low) // 2]) / 2
                scale = max(1.4826 * float(middle), _FINEST_SCATTER_PX)
                part = self._residual / (_TUKEY * scale)
                biweight = np.maximum(1 - part * part, 0.0) ** 2
                self._weights = np.where(self._residual > 0, biweight, 1.0)

    @property
    def variance(self) -> float:
        """Variance of a and b.

        Neighbouring distances share pixels: their errors are correlated over about two of them.
        """
        bread = np.linalg.pinv((self._design * self._weights) @ self._design.T)
        meat = self._design * (self._weights * self._residual) * np.sqrt(2.0)
        covariance = bread @ (meat @ meat.T) @ bread
        return float(0.5 * (covariance[1, 1] + covariance[2, 2]))
