"""Whether an edge is the border of what a ball mirrors, and not its outline."""

from __future__ import annotations

import cv2
import numpy as np

from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.outline.limb import gaussian
from calibration.spheres.outline.outline import image_noise
from rig.arrays import Float32, Float64

_COUNT, _ALONG = 180, 5.0
# Beyond the blur of the edge, in px, and over a part of the radius.
_MARGIN_PX = 2.5
_INSIDE, _OUTSIDE = (0.0, -0.01, -0.02), (0.0, 0.02, 0.04, 0.06)
# Surroundings that vary by less, as the standard deviation of the logarithm, decide nothing.
_LEAST_VARIATION = 0.25
# An edge of which less is in the image cannot be compared.
_LEAST_COMPARED = 0.25
# Of 50 drawn balls (seeds 750 to 799), 3 true outlines are below, and 29 borders.
_LEAST_SLOPE = 0.5
# Circles around an edge: their radii and shifts in its radii, and shifts in the gap between.
_AROUND, _ASIDE, _ASIDE_OF_GAP, _COARSE = (1.1, 1.5, 0.02), 0.12, 0.6, 120
# Around the borders of 40 drawn balls, 0.76 to 1 of a circle is darker inside by 5 %, and 0.79 to 1
# of its bright part; around their outlines up to 0.81, mostly 0.
_LEAST_STEP, _ALL_AROUND = 0.05, 0.72
# A circle decides where it is brighter than its image's offset, 20 times the noise or 1 % of the
# mean, by this factor, if it is so over this share. One of which half is in the image is hidden if
# it is not.
_BRIGHT, _OFFSET_SIGMAS, _OFFSET_SHARE = 5.0, 20.0, 0.01
_LEAST_BRIGHT, _MOST_SEEN, _MOST_HIDDEN = 0.1, 0.5, 0.5
_SMALL_PX = 20.0
_ROUNDS, _MOST = 6, 0.75


def is_mirrored_border(image: Float32, edge: Ellipse, *, mostly_seen: bool = True) -> bool:
    """Return whether an edge is the border of what a larger ball mirrors.

    A mirror ball shows at its limb what is behind it, at any distance, because the reflection is
    grazing there, and darker by its reflectance. So, around an outline, the logarithm of the
    brightness inside follows that outside if that is large and bright, and is lower all around. An
    edge that it does not follow is not the outline if another circle around it is: one at which the
    brightness is lower nearly all around, where its surroundings are bright. If the edge is mostly
    hidden, the other circle may be, too, so that the edge does not count if the surroundings of
    most circles are black.

    Parameters
    ----------
    image
        ``(H, W)``, above 0: the median over the lights, for instance.
    edge
        The edge, known to a pixel.
    mostly_seen
        Whether it is visible over most of its length.
    """
    if _follows(image, edge):
        return False
    around = _Around(image, edge)
    return around.show_ball or (not mostly_seen and around.are_hidden)


def _follows(image: Float32, edge: Ellipse) -> bool:
    """Return whether what is inside varies like what is outside; yes if that hardly varies."""
    inside, outside = (
        _ring(image, edge, sign * _MARGIN_PX / edge.radius_px, shares)
        for sign, shares in ((-1, _INSIDE), (1, _OUTSIDE))
    )
    use = np.isfinite(inside) & np.isfinite(outside)
    if np.count_nonzero(use) < _LEAST_COMPARED * _COUNT:
        return True
    inside, outside = inside[use], outside[use]
    if outside.std() < _LEAST_VARIATION:
        return True
    return _slope(outside, inside) >= _LEAST_SLOPE


class _Around:
    """Circles around an edge, each of which may be the outline of the ball that mirrors it.

    ``darker`` is where they are darker inside, ``much_darker`` where they are so by twice the least
    step, ``seen`` where they are within the image, and ``bright`` where their surroundings are
    bright, apart from the edge; ``(circles, angles)`` each.
    """

    def __init__(self, image: Float32, edge: Ellipse) -> None:
        radius = edge.radius_px
        shifts = np.linspace(-_ASIDE, _ASIDE, 9) * radius
        sizes = radius * np.arange(*_AROUND)
        trials = np.stack(np.meshgrid(shifts, shifts, sizes), axis=-1).reshape(-1, 3)
        trials = trials[np.hypot(*trials[:, :2].T) < _ASIDE_OF_GAP * (trials[:, 2] - radius)]
        centres = trials[:, None, :2] + edge.centre_px
        angles = np.arange(_COARSE) * (2 * np.pi / _COARSE)
        toward = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        smooth = cv2.GaussianBlur(np.log(image), (0, 0), 1.0)
        size = np.array(image.shape[::-1]) - 1
        rings, seen = [], np.ones((len(trials), _COARSE), bool)
        for sign in (-1, 1):
            at = (centres + (trials[:, 2:, None] + sign * _MARGIN_PX) * toward).astype(np.float32)
            seen &= np.all((at >= 0) & (at <= size), axis=-1)
            x, y = at[..., 0], at[..., 1]
            rings.append(cv2.remap(smooth, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
        offset = max(_OFFSET_SIGMAS * image_noise(image), _OFFSET_SHARE * float(image.mean()))
        # A circle that is next to the edge shows the step of the edge. All are next to a small one.
        inner = centres - edge.centre_px + (trials[:, 2:, None] - _MARGIN_PX) * toward
        apart = np.hypot(inner[..., 0], inner[..., 1]) > radius + 2 * _MARGIN_PX
        apart |= radius < _SMALL_PX
        step = rings[1] - rings[0]
        self.darker = step > _LEAST_STEP
        self.much_darker = step > 2 * _LEAST_STEP
        self.seen = seen
        self.bright = seen & apart & (rings[1] > np.log(_BRIGHT * offset))

    @property
    def show_ball(self) -> bool:
        """Whether one is darker inside nearly all around, where its surroundings are bright."""
        bright = self.bright.mean(axis=1)
        darker = (self.darker & self.bright).mean(axis=1)
        much = (self.much_darker & self.bright).mean(axis=1)
        balls = (darker > _ALL_AROUND * bright) & (much > 0.5 * bright)
        return bool(np.any(balls & (bright > _LEAST_BRIGHT)))

    @property
    def are_hidden(self) -> bool:
        """Whether most of them may be outlines, because their surroundings are black.

        A ball that is mostly beyond the image is not what a person marks.
        """
        black = (self.bright.mean(axis=1) <= _LEAST_BRIGHT) & (self.seen.mean(axis=1) > _MOST_SEEN)
        return bool(black.mean() > _MOST_HIDDEN)


def _slope(x: Float64, y: Float64) -> float:
    """Return the slope of a line through most points: windows and posts are the rest."""
    kept = np.ones(len(x), bool)
    slope = 0.0
    for _ in range(_ROUNDS):
        off = x - x[kept].mean()
        slope = float(off[kept] @ y[kept] / max(float(off[kept] @ off[kept]), 1e-12))
        left = np.abs(y - y[kept].mean() - slope * off)
        kept = left <= np.quantile(left, _MOST)
    return slope


def _ring(image: Float32, outline: Ellipse, start: float, shares: tuple[float, ...]) -> Float64:
    """Return the logarithm of the brightness around a ring, smooth, NaN beyond the image."""
    angles = np.arange(_COUNT) * (2 * np.pi / _COUNT)
    scale = 1 + start + np.array(shares)[:, None]
    place = outline.point(angles, scale).astype(np.float32)
    height, width = image.shape
    within = np.all((place >= 0) & (place <= (width - 1, height - 1)), axis=(0, 2))
    values = cv2.remap(
        image, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    ring: Float64 = np.log(values.mean(axis=0, dtype=np.float64))
    if within.any():
        ring[~within] = ring[within].mean()
    kernel = gaussian(_ALONG)
    closed = np.pad(ring, len(kernel) // 2, mode="wrap")
    return np.where(within, np.convolve(closed, kernel, "valid"), np.nan)
