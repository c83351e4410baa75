"""The outline of a ball from its blurred edge, with the light inside predicted by the mirror."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from calibration.radiance.stack import Images
from calibration.spheres.highlights.spots import without_nan
from calibration.spheres.outline.surroundings import Balls, MirroredPlane, outlines_of
from rig.arrays import Bool, Float64

_SAMPLE_PX, _CELL_PX = 0.5, 0.25
# The profiles reach inward by a share of the radius, within limits.
_INWARD, _INWARD_PX, _OUTWARD_PX = 0.1, (2.5, 5.0), 8.0
# Beyond the innermost sample, blur mixes in what is farther inside.
_DEEPER_PX = 3.0
_SPACING_PX, _FEWEST_ANGLES, _MOST_ANGLES = 2.0, 90, 540
_ROUNDS, _CONVERGED_PX = 20, 0.002
_USUAL_BLUR_PX, _BLURS_PX, _SMALL = 0.9, (0.3, 4.0), 0.05
_USUAL_REFLECTANCE = 0.6
# Profiles with this share of the brightness that the lights have there on average are lit.
_LIT = 0.5
_TUKEY, _MOST_UNUSUAL, _FINEST = 2.5, 1.5, 1e-3
# Neighbouring profiles have the same errors along this length of the outline.
_GROUP_PX, _FEWEST_GROUPS, _MOST_GROUPS = 12.0, 12, 36
_LEAST_SEEN = 0.3
# Errors of the model on an even plane, and by the contrast of a texture.
_MODEL_PX, _BY_TEXTURE_PX = 0.003, (2.0, 2.0, 3.0)
_MOST_MOVE_PX, _LARGEST_PX = 1.0, 0.5


@dataclass(frozen=True, eq=False)
class LimbFit:
    """A ball whose outline was fitted to its edge.

    Parameters
    ----------
    ball
        The ball.
    covariance_px2
        ``(3, 3)`` covariance of centre x, centre y and radius of its outline.
    blur_px
        Standard deviation of the blur at the edge, the size of a pixel included.
    scatter_px
        Robust scatter of the edge at single angles about this outline.
    """

    ball: Balls
    covariance_px2: Float64
    blur_px: float
    scatter_px: float


def fit_limb(values: Images, plane: MirroredPlane, ball: Balls) -> LimbFit | None:
    """Fit the outline of a ball that mirrors the plane to its edge in each image.

    Across the outline, the brightness under one light is a blurred step. Outside is the plane,
    a straight line of brightness. Inside is the plane that the ball mirrors, which the camera sees
    elsewhere, times the reflectance of the ball. So both sides of the step are known under each
    light, in and out of shadows, and the edge is where the step is: place, radius, blur and
    reflectance are fitted to all profiles together by Gauss-Newton. Profiles that do not follow
    the model, for example because the edge of a shadow or a print crosses them, have no weight;
    the usual residual of a light decides (Tukey's biweight).

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    plane
        The same images.
    ball
        One ball, to a pixel.

    Returns
    -------
    LimbFit or None
        None if the edge does not determine the outline to half a pixel.
    """
    profiles = _Profiles(values, plane, ball)
    blur, reflectance = _USUAL_BLUR_PX, _USUAL_REFLECTANCE
    trial = ball
    for _ in range(_ROUNDS):
        normal = profiles.normal(trial, blur, reflectance)
        if normal is None:
            return None
        information, by_angle, by_place = normal
        inverse = np.linalg.pinv(information, hermitian=True)
        step = inverse @ by_angle.sum(axis=0)
        move = np.clip(step[:3], -_MOST_MOVE_PX, _MOST_MOVE_PX)
        trial = Balls(trial.axes_px + move[:2], trial.radii_px + move[2], trial.slopes)
        blur = float(np.clip(blur + np.clip(step[3], -0.3, 0.3), *_BLURS_PX))
        reflectance += float(np.clip(step[4], -0.1, 0.1))
        if np.abs(step[:4]).max() < _CONVERGED_PX:
            break
    else:
        return None
    if not _BLURS_PX[0] < blur < _BLURS_PX[1]:
        return None
    length = 2 * np.pi * float(ball.radii_px[0])
    groups = int(np.clip(length / _GROUP_PX, _FEWEST_GROUPS, _MOST_GROUPS))
    of_group = np.arange(len(by_angle)) * groups // len(by_angle)
    sums = np.array([by_angle[of_group == group].sum(axis=0) for group in range(groups)])
    used = np.count_nonzero(sums.any(axis=1))
    if used < _FEWEST_GROUPS * _LEAST_SEEN + 5:
        return None
    scatter = sums.T @ sums * (used / (used - 5))
    covariance = (inverse @ scatter @ inverse)[:3, :3] + np.diag(profiles.model_errors_px() ** 2)
    if np.linalg.eigvalsh(covariance)[-1] > _LARGEST_PX**2:
        return None
    # Blur moves the half-way brightness of a convex edge inward.
    radii = trial.radii_px + blur**2 / (2 * trial.radii_px)
    seen = by_place > 0
    scatter = 1.4826 * float(np.median(np.abs(by_angle[seen, 2] / by_place[seen])))
    return LimbFit(replace(trial, radii_px=radii), covariance, blur, scatter)


class _Profiles:
    """Images across the outline of a ball, and what the model of a blurred step expects."""

    def __init__(self, values: Images, plane: MirroredPlane, ball: Balls) -> None:
        self._plane = plane
        self._texture = 0.0
        size = float(ball.radii_px[0])
        inward = float(np.clip(_INWARD * size, *_INWARD_PX))
        self._offsets = np.arange(
            -inward, _OUTWARD_PX + _SAMPLE_PX / 2, _SAMPLE_PX, dtype=np.float64
        )
        self._cells = np.arange(0, inward + _DEEPER_PX, _CELL_PX, dtype=np.float64)
        count = 2 * np.pi * size / _SPACING_PX
        self._count = int(np.clip(count, _FEWEST_ANGLES, _MOST_ANGLES))
        around = outlines_of(plane.camera, ball, self._count)[0]
        reach = _OUTWARD_PX + 2 * _MOST_MOVE_PX
        self._low = np.maximum(np.floor(around.min(axis=0) - reach).astype(int), 0)
        high = np.minimum(np.ceil(around.max(axis=0) + reach).astype(int) + 1, values.shape[:0:-1])
        (x0, y0), (x1, y1) = self._low, np.maximum(high, self._low + 1)
        some = values[plane.some]
        self._images = [without_nan(some[k, y0:y1, x0:x1]) for k in range(len(some))]

    def model_errors_px(self) -> Float64:
        """Return the errors ``(3,)`` of place and radius by print and texture."""
        return np.hypot(_MODEL_PX, np.array(_BY_TEXTURE_PX) * self._texture)

    def normal(
        self, ball: Balls, blur: float, reflectance: float
    ) -> tuple[Float64, Float64, Float64] | None:
        """Return the normal equations of place, radius, blur and reflectance.

        These are the information matrix ``(5, 5)``, the right side of each angle ``(J, 5)``, and
        the information ``(J,)`` of each angle about the place of the edge; None if too little of
        the outline can be compared.
        """
        around = outlines_of(self._plane.camera, ball, self._count)[0]
        along = np.roll(around, -1, axis=0) - np.roll(around, 1, axis=0)
        outward = np.column_stack([along[:, 1], -along[:, 0]])
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        outward *= np.sign(np.sum(outward * (around - around.mean(axis=0))))
        seen, in_image = self._sampled(around, outward)
        mirrored, in_plane = self._plane.mirrored(ball, self._cells + _CELL_PX / 2, self._count)
        use = in_image & in_plane
        if use.mean() < _LEAST_SEEN:
            return None
        # The derivatives by the place of the edge and by the blur are symmetric differences.
        places = ((0.0, 0.0), (_SMALL, 0.0), (-_SMALL, 0.0), (0.0, _SMALL), (0.0, -_SMALL))
        steps = [self._step(edge, blur + wider) for edge, wider in places]
        inside, outside = steps[0]
        shown = mirrored @ inside.T
        solve = np.linalg.pinv(outside)
        line = (seen - reflectance * shown) @ solve.T
        slopes = [shown]
        for (inner, outer), (inner_back, outer_back) in (steps[3:], steps[1:3]):
            change = reflectance * (mirrored @ (inner - inner_back).T)
            slopes.insert(0, (change + line @ (outer - outer_back).T) / (2 * _SMALL))
        # What the straight line outside can explain does not count.
        rest = np.eye(len(outside)) - outside @ solve
        residuals = (seen - reflectance * shown) @ rest.T
        derivatives = np.stack([slope @ rest.T for slope in slopes], axis=-1)
        weights = _weights(residuals, seen, use)
        if not weights.any():
            return None
        self._texture = _texture(residuals, seen, weights)
        of_pair = np.einsum("njsa,njsb,nj->jab", derivatives, derivatives, weights)
        of_angle = np.einsum("njsa,njs,nj->ja", derivatives, residuals, weights)
        # Place and radius move the edge along the normal of the outline.
        chain = np.zeros((self._count, 3, 5))
        chain[:, 0, :2], chain[:, 0, 2], chain[:, 1, 3], chain[:, 2, 4] = outward, 1, 1, 1
        information: Float64 = np.einsum("jap,jab,jbq->pq", chain, of_pair, chain)
        return information, np.einsum("jap,ja->jp", chain, of_angle), of_pair[:, 0, 0]

    def _sampled(self, around: Float64, outward: Float64) -> tuple[Float64, Bool]:
        """Return the images ``(N, J, S)`` across the outline, and where all are in the image."""
        places = around[:, None] + self._offsets[:, None] * outward[:, None] - self._low
        x, y = (np.ascontiguousarray(places[..., axis], np.float32) for axis in (0, 1))
        height, width = self._images[0].shape
        inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
        seen = [
            cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for image in self._images
        ]
        return np.stack(seen).astype(np.float64), inside.all(axis=1)

    def _step(self, edge: float, blur: float) -> tuple[Float64, Float64]:
        """Return what the inside ``(S, cells)`` and a line outside ``(S, 2)`` contribute."""
        # Imported here: scipy.special takes 0.1 s, and balls without a plane do not need it.
        from scipy.special import ndtr

        apart = self._offsets - edge
        nearer = -(self._cells + apart[:, None]) / blur
        inside = ndtr(nearer) - ndtr(nearer - _CELL_PX / blur)
        inside[:, -1] = ndtr(nearer[:, -1])  # the last cell continues inward
        share = ndtr(apart / blur)
        ramp = apart * share + blur * np.exp(-0.5 * (apart / blur) ** 2) / np.sqrt(2 * np.pi)
        return inside, np.column_stack([share, ramp])


def _weights(residuals: Float64, seen: Float64, use: Bool) -> Float64:
    """Return the weights ``(N, J)`` of profiles: of those that are lit and follow the model."""
    level = np.maximum(seen.mean(axis=-1), 1e-9)
    lit = use & (level > _LIT * level.mean(axis=0))
    misfit = np.sqrt(np.mean(residuals**2, axis=-1)) / level
    pairs = zip(misfit, lit, strict=True)
    each = np.array([np.median(m[shown]) if shown.any() else np.inf for m, shown in pairs])
    # A low light may have the edge of its shadow along most of the outline.
    usual = np.clip(each, _FINEST, max(_MOST_UNUSUAL * float(np.median(each)), _FINEST))[:, None]
    fits = np.clip(1 - (misfit / (_TUKEY * usual)) ** 2, 0, None) ** 2
    return np.where(lit, fits / (usual * level) ** 2, 0.0)


def _texture(residuals: Float64, seen: Float64, weights: Float64) -> float:
    """Return the contrast of the print and texture that the model lacks.

    It is the same under all lights, relative to their brightness; noise is not. So it is what the
    mean of the lights keeps of their residuals, without the noise of this mean.
    """
    level = np.maximum(seen.mean(axis=-1, keepdims=True), 1e-9)
    relative, weight = residuals / level, weights[..., None] * level**2
    total = np.maximum(weight.sum(axis=0), 1e-300)
    share = weight / total
    shared = np.sum(share * relative, axis=0)
    of_one = np.sum(share**2, axis=0)
    noise = np.sum(share**2 * (relative - shared) ** 2, axis=0) / np.maximum(1 - of_one, 1e-3)
    square = np.average(shared**2 - noise, axis=0, weights=total[:, 0])
    return float(np.sqrt(max(square.mean(), 0.0)))
