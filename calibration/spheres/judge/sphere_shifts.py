"""Images in which a sphere, with what is around it, is not where the other images show it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from calibration.radiance.stack import Images
from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.outline.limb import Profiles, stack_profiles
from rig.arrays import Float64, Intp

# Profiles around an outline, their reach to both sides, and the distance of their samples in radii.
_ANGLES, _REACH, _STEP = 120, 0.4, 1 / 200
_LEAST_REACH_PX, _LEAST_STEP_PX, _LEAST_BLUR_PX = 8.0, 0.5, 0.7
# Larger spheres are compared in images that are smaller by a whole factor.
_LARGE_PX = 150.0
# Shifts in samples: a grid, and the steps of the search around its best place.
_GRID, _STEPS, _FINE_STEPS = 4, (2.0, 1.0, 0.5, 0.25), (0.12, 0.06, 0.03)
_SECTORS = 12
_ROUNDS = 2
# An image moved if its edges agree better elsewhere, by this much (1 is perfect agreement), and by
# so many standard deviations of the mean over the sectors. The difference is 0.010 or less in
# images that did not move, and up to 0.026 in a few sectors of these.
_GAIN, _SIGMAS = 0.012, 2.0
_LARGE_GAIN, _OF_LARGE_GAIN = 0.08, 1.5
_LEAST_SHIFT_PX = 0.7
# Shadows and highlights of few other images are not averaged: 0.7 to 1.1 px in 6 of 468 draws of 3
# to 6 images.
_FEW, _LEAST_OF_FEW_PX, _FEWEST = 8, 1.2, 3
# On smaller spheres, highlights and shadows are too near to the outline.
_SMALLEST_PX = 12.0
_WAYS = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]


def displaced(
    values: Images, outline: Ellipse, known_px: Float64 | None = None
) -> dict[int, float]:
    """Return the images in which a sphere is elsewhere than in the others, and how far, in px.

    The brightness changes from light to light, but the edges around a sphere (its outline, what is
    behind it) stay. Along radii across the outline, the square roots of the slopes in an image are
    correlated with the mean of those in the others. Each profile has the same weight, so that
    highlights and shadows count at a few angles only. An image has moved if its edges agree better
    with those of the others after a shift, more than chance allows, and at most angles. The one
    that gains most by that leaves the mean, and the others are compared again.

    Shifts of up to 0.4 radii are seen. It stays unknown whether an image moved that shows hardly
    any edge around the sphere. Fewer than three images, and spheres below 12 px, show nothing.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    outline
        The outline that most images show.
    known_px
        ``(N, 2)``: how far it is known to be elsewhere; default: nowhere.
    """
    height, width = values.shape[1:]
    x, y = outline.centre_px
    visible = 0 <= x < width and 0 <= y < height and outline.radius_px >= _SMALLEST_PX
    if len(values) < _FEWEST or not visible:
        return {}
    least_px = _LEAST_SHIFT_PX if len(values) >= _FEW else _LEAST_OF_FEW_PX
    slopes, step_px = _slopes(values, outline, known_px)
    shifts = _Shifts(slopes.shape[2] // 2)
    left, total = list(range(len(values))), slopes.sum(axis=0)
    found: dict[int, float] = {}
    while len(left) >= max(_FEWEST, len(values) // 2 + 1):
        best_gain, worst, far_px = 0.0, -1, 0.0
        for k in left:
            others = (total - slopes[k]) / (len(left) - 1)
            gain, shift = shifts.best(slopes[k], others)
            if gain > best_gain and shift * step_px > least_px:
                best_gain, worst, far_px = gain, k, shift * step_px
        if worst < 0:
            break
        left.remove(worst)
        total = total - slopes[worst]
        found[worst] = far_px
    return found


def sphere_shifts(values: Images, outline: Ellipse) -> Float64:
    """Return by how much a sphere is further right and down in each image, ``(N, 2)`` px.

    The edges are compared as in `displaced`, of which the parameters are. The shifts are against
    their median, with standard deviations of about 0.1 px along each axis.
    """
    found: Float64 = np.zeros((len(values), 2))
    for _ in range(_ROUNDS):  # the mean of shifted edges is blurred at first
        slopes, step_px = _slopes(values, outline, found)
        shifts, total = _Shifts(slopes.shape[2] // 2), slopes.sum(axis=0)
        steps = [shifts.nearest(one, (total - one) / (len(values) - 1)) for one in slopes]
        found = found + np.array(steps) * step_px
        found -= np.median(found, axis=0)
    return found


def _slopes(
    values: Images, outline: Ellipse, known_px: Float64 | None = None
) -> tuple[Profiles, float]:
    """Return slopes across an outline, ``(N, angles, samples)``, and the distance of samples in px.

    Each profile has the mean 0, and the norm 1, or less if it is hardly more than noise.
    """
    reach_px = max(_REACH * outline.radius_px, _LEAST_REACH_PX)
    known = np.zeros((len(values), 2)) if known_px is None else known_px
    far = outline.radius_px + reach_px + 2 + float(np.abs(known).max())
    low = np.maximum((np.array(outline.centre_px) - far).astype(int), 0)
    high = (np.array(outline.centre_px) + far).astype(int) + 2
    factor = max(int(outline.radius_px / _LARGE_PX), 1)
    # The centre of the first pixel of a smaller image is between the first pixels.
    centre = tuple(((np.array(outline.centre_px) - low - (factor - 1) / 2) / factor).tolist())
    axes = outline.semi_axes_px
    small = Ellipse(centre, (axes[0] / factor, axes[1] / factor), outline.angle_deg)
    step = max(_STEP * small.radius_px, _LEAST_STEP_PX)
    blur, count = max(step, _LEAST_BLUR_PX), round(reach_px / factor / step)
    offsets: Float64 = np.arange(-count, count + 1, dtype=np.float64) * step
    profiles_of: list[Profiles] = []
    for k in range(len(values)):
        part = values[k, low[1] : high[1], low[0] : high[0]]
        image = np.where(np.isnan(part), np.float32(1), part)
        if factor > 1:
            size = max(image.shape[1] // factor, 1), max(image.shape[0] // factor, 1)
            rows, columns = size[1] * factor, size[0] * factor
            image = cv2.resize(image[:rows, :columns], size, interpolation=cv2.INTER_AREA)
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur), np.float32)
        there = small.moved(np.array([*(known[k] / factor), 0.0]))
        profiles_of.append(stack_profiles([image], there, _angles(), offsets)[:, 0].T)
    profiles = np.stack(profiles_of)
    rough = np.median(np.abs(np.diff(profiles, 3, axis=-1)), axis=(1, 2)) + 1e-6
    slopes = np.sqrt(np.abs(profiles[..., 2:] - profiles[..., :-2]))
    slopes -= slopes.mean(axis=-1, keepdims=True)
    power = np.sum(slopes**2, axis=-1) + slopes.shape[-1] * rough[:, None]
    return slopes / np.sqrt(power)[..., None], step * factor


@dataclass(frozen=True)
class _Shifts:
    """Shifts of an image, at most ``farthest`` samples, that are compared."""

    farthest: int

    def best(self, slopes: Profiles, others: Profiles) -> tuple[float, float]:
        """Return by how much a shift improves the agreement, and the shift in samples.

        Parameters
        ----------
        slopes, others
            ``(angles, samples)`` of an image, and the mean of those of the others.

        Returns
        -------
        gain, shift
            Both 0 if chance explains them.
        """
        agreement, shift = self._search(slopes, others)
        gains = self._at(agreement, shift) - self._at(agreement, np.zeros(2))
        of_sectors = gains.reshape(_SECTORS, -1).mean(axis=1)
        gain = float(of_sectors.mean())
        sigma = float(of_sectors.std()) / np.sqrt(_SECTORS)
        clear = gain > _GAIN and gain > _SIGMAS * sigma
        large = gain > _LARGE_GAIN and gain > _OF_LARGE_GAIN * sigma
        return (gain, float(np.hypot(*shift))) if clear or large else (0.0, 0.0)

    def nearest(self, slopes: Profiles, others: Profiles) -> Float64:
        """Return the shift in samples after which the agreement is best."""
        agreement, shift = self._search(slopes, others)
        return self._climb(agreement, shift, _FINE_STEPS)[1]

    def _search(self, slopes: Profiles, others: Profiles) -> tuple[Profiles, Float64]:
        """Return the agreement at each angle after each shift along it, and the best shift."""
        size, most = 2 * slopes.shape[1], self.farthest
        product = np.fft.rfft(slopes, size) * np.conj(np.fft.rfft(others, size))
        circular = np.fft.irfft(product, size)
        agreement = np.concatenate([circular[:, -most:], circular[:, : most + 1]], axis=1)
        # Slopes of one pixel: their correlation is too narrow for the steps of the search.
        agreement[:, 1:-1] = (agreement[:, :-2] + 2 * agreement[:, 1:-1] + agreement[:, 2:]) / 4
        x, y = self._grid
        coarse = np.take(agreement.ravel(), self._places).mean(axis=1)
        at = int(np.argmax(coarse))
        starts = [np.array([x[at], y[at]]), np.zeros(2)]
        ends = [self._climb(agreement, start) for start in starts]
        return agreement, max(ends, key=lambda end: end[0])[1]

    def _climb(
        self, agreement: Profiles, start: Float64, steps: tuple[float, ...] = _STEPS
    ) -> tuple[float, Float64]:
        """Return the largest mean agreement near a shift, and its shift."""
        shift, best = start, float(self._at(agreement, start).mean())
        for step in steps:
            for _ in range(3):
                trials = [shift + step * np.array(way) for way in _WAYS]
                means = [float(self._at(agreement, trial).mean()) for trial in trials]
                if max(means) <= best:
                    break
                best = max(means)
                shift = trials[int(np.argmax(means))]
        return best, shift

    def _at(self, agreement: Profiles, shift: Float64) -> Float64:
        """Return the agreement ``(angles,)`` after a shift, by cubic interpolation."""
        cosine, sine = self._directions
        place = np.clip(shift[0] * cosine + shift[1] * sine, 1 - self.farthest, self.farthest - 2)
        first = np.floor(place).astype(np.intp)
        part, angle = place - first, np.arange(_ANGLES)
        a, b, c, d = (agreement[angle, first + self.farthest + k] for k in (-1, 0, 1, 2))
        curve = 2 * a - 5 * b + 4 * c - d + part * (3 * (b - c) + d - a)
        return np.asarray(b + 0.5 * part * (c - a + part * curve), np.float64)

    @cached_property
    def _directions(self) -> tuple[Float64, Float64]:
        return np.cos(_angles()), np.sin(_angles())

    @cached_property
    def _grid(self) -> tuple[Float64, Float64]:
        reach = np.arange(-self.farthest, self.farthest + 1, _GRID, dtype=np.float64)
        x, y = (of.ravel() for of in np.meshgrid(reach, reach))
        near = np.hypot(x, y) <= self.farthest
        return x[near], y[near]

    @cached_property
    def _places(self) -> Intp:
        """Where the agreement of each shift of the grid is at each angle, rounded."""
        (x, y), (cosine, sine) = self._grid, self._directions
        shifts = np.rint(np.multiply.outer(x, cosine) + np.multiply.outer(y, sine)).astype(np.intp)
        rows = np.arange(_ANGLES) * (2 * self.farthest + 1)
        return np.asarray(shifts + self.farthest + rows, np.intp)


def _angles() -> Float64:
    return np.arange(_ANGLES, dtype=np.float64) * (2 * np.pi / _ANGLES)
