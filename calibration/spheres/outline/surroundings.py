"""Whether a ball at a place mirrors the plane on which it rests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from acquisition import CameraModel
from calibration.radiance.stack import Images
from calibration.spheres.highlights.spots import ReducedStack, reduced_image, without_nan
from calibration.spheres.outline.outline import IMMERKAER
from rig.arrays import Bool, Float32, Float64, Floating, Intp

# The focal length of an unknown camera, in multiples of the larger side of the image. Half or twice
# of it moves the mirrored points by less than the tolerance.
_USUAL_FOCAL = 2.5
_LIGHTS = 12
# Near the limb, the sphere mirrors the plane up to three radii from its centre.
_DEPTHS = (0.88, 0.92, 0.96)
_TOLERANCE = 0.05
_FINE_TOLERANCE = 0.03
_DOWNWARD = 0.05
# Blocks of the reduced images squared, over the radius: at this depth, a ball mirrors a point that
# is seven blocks away from its outline.
_CLEAR_BLOCKS = 6.0
_LEAST_DEPTH_PX = 2.0
# Texture is finer than this, in reduced pixels, and shading is coarser.
_LOCAL_PX = 3.0
_CHANNELS = 4


@dataclass(frozen=True, eq=False)
class Balls:
    """H trial balls that rest on the plane z = 0, as the camera sees them.

    Parameters
    ----------
    axes_px
        ``(H, 2)`` pixels of their centres.
    radii_px
        ``(H,)`` radii of their outlines across the direction to the image's centre.
    slopes
        ``(H, 2)`` slopes of the plane under each ball along x and y; default 0.
    """

    axes_px: Float64
    radii_px: Float64
    slopes: Float64 | None = None


@dataclass(frozen=True, eq=False)
class Likeness:
    """How well trial balls mirror their surroundings.

    Parameters
    ----------
    share
        ``(H,)`` share of the differences between lights and places near the limb that is explained
        by the mirrored plane: 1 for a mirror, 0 or less otherwise.
    contrast
        ``(H,)`` mean square of these differences, in multiples of noise and tolerance.
    seen
        ``(H,)`` share of the points near the limb whose mirrored point is in the image.
    """

    share: Float64
    contrast: Float64
    seen: Float64


def usual_camera(width: int, height: int) -> CameraModel:
    """Return a camera with a usual focal length, for images of an unknown camera."""
    focal = _USUAL_FOCAL * max(width, height)
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    return CameraModel(K, width, height, 1.0)


def outlines_of(camera: CameraModel, balls: Balls, count: int) -> Float64:
    """Return the outlines of trial balls as pixels ``(H, count, 2)``."""
    angles = np.arange(count) * (2 * np.pi / count)
    return _points(camera, balls, np.ones(1), angles)[0]


class MirroredPlane:
    """Compares what a ball would mirror with what the camera sees there.

    At a depth of a tenth of the radius inside the outline, a mirror ball that rests on a matte
    plane shows points of the plane up to three radii away, which are visible themselves. The ratio
    of their brightness under one light to the mean over the lights does not depend on their albedo
    nor on the reflectance of the ball. So the ratios near the limb equal those of the mirrored
    points, whatever is printed on the plane. A wrong radius or centre shows other points; a circle
    that is mirrored in a ball, a print, or a matte ball do not mirror the plane at all.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    reduced
        The same at a lower resolution, to which the mirrored points are compared.
    camera
        Camera of the images; None for a usual one. Its scale does not matter.
    """

    def __init__(
        self, values: Images, reduced: ReducedStack, camera: CameraModel | None = None
    ) -> None:
        height, width = values.shape[1:]
        self.camera = usual_camera(width, height) if camera is None else camera
        self.camera_known = camera is not None
        self.some = slice(None, None, max(len(values) // _LIGHTS, 1))
        self._values = values[self.some]
        self._factor = reduced.factor
        self._plane = reduced.mean[self.some]
        self._reduced = Quads(list(self._plane))
        self._noise = _noise(self._plane)
        # Of a pixel, if the noise of neighbouring pixels is independent.
        self.noise = self._noise * self._factor
        # Parts of the images at the resolutions that were asked for last, by their factors.
        self._blurred: dict[int, Quads] = {}
        self._parts: dict[int, tuple[Float64, Quads]] = {}

    def compare(self, balls: Balls, spokes: int = 36) -> Likeness:
        """Return how well the balls, of similar size and place, mirror their surroundings."""
        angles = np.arange(spokes) * (2 * np.pi / spokes)
        limb, mirrored, down = _points(self.camera, balls, np.array(_DEPTHS), angles)
        # What one pixel near the limb mirrors is several pixels wide.
        size = float(np.median(balls.radii_px))
        near, in_image = self._limb(limb, size)
        far, in_plane = self._mirrored(mirrored, size)
        use = down & in_image & in_plane
        mean_near = np.maximum(near.mean(axis=0), 1e-6)
        mean_far = np.maximum(far.mean(axis=0), 1e-6)
        ratio, expected = near / mean_near, far / mean_far
        noise = (self._noise / mean_near) ** 2 + (0.3 * self._noise / mean_far) ** 2
        weight = use / (noise + _TOLERANCE**2)
        usual = (weight * ratio).sum(axis=-1) / np.maximum(weight.sum(axis=-1), 1e-9)
        # One point counts at most as a difference of all of its light.
        left = np.minimum(weight * (ratio - expected) ** 2, weight).sum(axis=(0, 2))
        total = np.minimum(weight * (ratio - usual[..., None]) ** 2, weight).sum(axis=(0, 2))
        points = np.maximum(use.sum(axis=-1), 1) * len(near)
        return Likeness(1 - left / np.maximum(total, 1e-9), total / points, use.mean(axis=-1))

    def differences(
        self, balls: Balls, depths: Floating, spokes: int, spread_px: Float64, weights: Float64
    ) -> tuple[Float64, Bool]:
        """Return how the images near the limb differ from the mirrored plane, and where they can.

        Parameters
        ----------
        balls
            H balls that hardly differ.
        depths
            Distances from a ball's axis in multiples of that of its outline.
        spokes
            Number of angles around the outline.
        spread_px, weights
            Distances along the radius over which a pixel averages, and their shares.

        Returns
        -------
        differences
            ``(C, H, P)``: for each light the difference of the ratios, and last the difference of
            the logarithms of the means up to a constant; all in multiples of noise and tolerance.
        use
            ``(H, P)``.
        """
        angles = np.arange(spokes) * (2 * np.pi / spokes)
        size = float(np.median(balls.radii_px))
        limb, _, use = _points(self.camera, balls, depths, angles)
        seen, inside = self._limb(limb, size / 4)
        use = use & inside
        near = seen.astype(np.float64)
        far = np.zeros_like(near)
        for shift, weight in zip(spread_px, weights, strict=True):
            at = np.clip(depths + shift / size, 0.0, 0.998)
            _, mirrored, down = _points(self.camera, balls, at, angles)
            part, inside = self._mirrored(mirrored, 0.0)
            far += weight * part
            use = use & down & inside
        mean_near = np.maximum(near.mean(axis=0), 1e-6)
        mean_far = np.maximum(far.mean(axis=0), 1e-6)
        noise = (self._noise / mean_near) ** 2 + (0.3 * self._noise / mean_far) ** 2
        ratios = (near / mean_near - far / mean_far) / np.sqrt(noise + _FINE_TOLERANCE**2)
        fading = np.log(mean_near / mean_far)
        fading -= np.median(fading[use]) if use.any() else 0.0
        fading *= 0.5 * np.sqrt(len(near) / (noise / len(near) + _TOLERANCE**2))
        return np.concatenate([ratios, fading[None]]), use

    def mirrored(self, ball: Balls, depths_px: Float64, spokes: int) -> tuple[Float64, Bool]:
        """Return what the limb of one ball mirrors, and at which angles it is in the image.

        Where what deeper parts mirror is beyond the frame, the last depth within it continues.

        Parameters
        ----------
        ball
            The ball.
        depths_px
            ``(D,)`` depths inside its outline, the least one first.
        spokes
            Number J of angles around the outline.

        Returns
        -------
        mirrored
            ``(N, J, D)`` images of the plane.
        use
            ``(J,)``.
        """
        size = float(ball.radii_px[0])
        # Closer to the outline than seven blocks of pixels, the reduced images show the ball, too.
        pixels = np.maximum(depths_px, _CLEAR_BLOCKS * self._factor**2 / size)
        depths = _depths_of(1 - pixels / size, float(_sines(self.camera, ball)[0]))
        angles = np.arange(spokes) * (2 * np.pi / spokes)
        _, places, down = _points(self.camera, ball, depths, angles)
        images, inside = self._mirrored(places, 0.0)
        use = np.logical_and.accumulate((down & inside).reshape(len(depths), spokes)).T
        images = np.moveaxis(images.reshape(-1, len(depths), spokes), 1, 2)
        last = np.minimum(np.maximum(use.sum(axis=1) - 1, 0)[:, None], np.arange(len(depths)))
        mirrored = np.take_along_axis(images, np.broadcast_to(last, images.shape), axis=2)
        near: Bool = np.all(use[:, depths_px <= _LEAST_DEPTH_PX], axis=1)
        return mirrored.astype(np.float64), near

    def _limb(self, pixels: Float64, size: float) -> tuple[Float32, Bool]:
        """Sample the images near the limb, with pixels of at most a fortieth of a size."""
        factor = 2 ** int(np.log2(max(size / 40, 1)))
        if factor >= self._factor:
            # The reduced images are fine enough: no need to read the images again.
            return self._reduced.at((pixels + 0.5) / self._factor - 0.5)
        side = np.array(self._values.shape[:0:-1])
        low = np.clip(pixels.min(axis=(0, 1)) - 2, 0, side - 1)
        high = np.clip(pixels.max(axis=(0, 1)) + 3, low + 1, side)
        part = self._parts.get(factor)
        if part is None or np.any(low < part[0][0]) or np.any(high > part[0][1]):
            margin = 0.5 * (high - low)
            box = np.array([np.maximum(low - margin, 0), np.minimum(high + margin, side)])
            part = self._parts[factor] = self._cut(factor, box.astype(int))
        return part[1].at((pixels - part[0][0] + 0.5) / factor - 0.5)

    def _cut(self, factor: int, box: Intp) -> tuple[Float64, Quads]:
        """Return a box, and this part of the images at a lower resolution."""
        (x0, y0), (x1, y1) = box
        shape = (max((x1 - x0) // factor, 1), max((y1 - y0) // factor, 1))
        stack = []
        for k in range(len(self._values)):
            part = without_nan(self._values[k, y0:y1, x0:x1])
            if factor > 1:
                part = reduced_image(part, shape, factor)
            stack.append(part)
        return box.astype(np.float64), Quads(stack)

    def _mirrored(self, pixels: Float64, size: float) -> tuple[Float32, Bool]:
        octave = max(round(np.log2(max(0.05 * size / self._factor, 0.5))), -1)
        if octave not in self._blurred:
            blur = 2.0**octave
            images = [cv2.GaussianBlur(image, (0, 0), blur) for image in self._plane]
            self._blurred[octave] = Quads(images)
        return self._blurred[octave].at((pixels + 0.5) / self._factor - 0.5)


def _noise(stack: Float32) -> float:
    """Return the noise of single images, with Immerkaer's kernel.

    A fine texture looks like noise in one image, but not in the differences between lights: what
    the kernel shows of the mean image, times the local brightness of an image, is texture.
    """
    mean = stack.mean(axis=0)
    texture = cv2.filter2D(mean, -1, IMMERKAER)
    smooth = np.maximum(cv2.GaussianBlur(mean, (0, 0), _LOCAL_PX), 1e-6)
    noises = []
    for image in stack[:: max(len(stack) // 4, 1)]:
        relative = cv2.GaussianBlur(image, (0, 0), _LOCAL_PX) / smooth
        rest = cv2.filter2D(image, -1, IMMERKAER) - relative * texture
        noises.append(np.percentile(np.abs(rest), 50) / 4.05)
    # The mean contains a share of the noise of each image.
    return float(np.median(noises) / np.sqrt(1 - 1 / max(len(stack), 2)))


def _sines(camera: CameraModel, balls: Balls) -> Float64:
    """Return the sines ``(H,)`` of the angles between the axes of balls and their outlines."""
    rays = camera.rays(balls.axes_px)
    cosine = -rays[:, 2] / np.linalg.norm(rays, axis=-1)
    return np.asarray(balls.radii_px * cosine / np.hypot(camera.focal_px, balls.radii_px))


def _depths_of(shares: Float64, sine: float) -> Float64:
    """Return the depths (see `_points`) that are seen at shares of the radius in the image.

    The middle of a ball is nearer to the camera than its outline, and therefore larger.
    """
    outline = np.arcsin(sine)
    angle = np.arctan(shares * np.tan(outline))
    incidence = np.arcsin(np.sin(angle) / sine)
    return np.asarray(np.sin(incidence - angle) / np.cos(outline))


def _points(
    camera: CameraModel, balls: Balls, depths: Floating, angles: Floating
) -> tuple[Float64, Float64, Bool]:
    """Return pixels ``(H, P, 2)`` on balls, the pixels of what they mirror, and which look down.

    ``depths`` are distances from the ball's axis in multiples of that of the outline.
    """
    height = 1.0 if camera.working_distance_mm is None else camera.working_distance_mm
    if camera.working_distance_mm is None:
        camera = CameraModel(camera.K, camera.width, camera.height, height, camera.distortion)
    # Vectors are along the first axis: sums along a last axis of three values are slow.
    eye = np.array([0.0, 0.0, height])[:, None, None]
    axes = -camera.rays(balls.axes_px).T
    axes /= np.linalg.norm(axes, axis=0)
    cosine, sine = axes[2], _sines(camera, balls)
    # The distance at which the ball touches the plane.
    distance = height / (cosine + sine)
    radii = (distance * sine)[:, None]
    first = np.cross([0.0, 1.0, 0.0], axes, axisb=0).T
    first /= np.linalg.norm(first, axis=0)
    second = np.cross(axes, first, axis=0)
    depth, angle = (v.ravel() for v in np.meshgrid(depths, angles, indexing="ij"))
    # At the outline, the normal is at a right angle to the viewing ray.
    across = depth * np.sqrt(1 - sine[:, None] ** 2)
    normals = np.sqrt(1 - across**2) * axes[..., None]
    normals += across * np.cos(angle) * first[..., None]
    normals += across * np.sin(angle) * second[..., None]
    offsets = radii * normals
    view = offsets - (distance * axes)[..., None]
    points = eye + view
    view /= np.sqrt(_dot(view, view))
    mirrored = view - 2 * _dot(view, normals) * normals
    upward = np.array([0.0, 0.0, 1.0])[:, None, None]
    if balls.slopes is not None:
        upward = np.stack([*-balls.slopes.T, np.ones(len(balls.slopes))])[..., None]
        upward /= np.sqrt(_dot(upward, upward))
    # The plane touches the ball from below.
    rise = _dot(offsets, upward) + radii
    fall = _dot(mirrored, upward)
    down = fall < -_DOWNWARD
    reach = np.where(down, -rise / np.minimum(fall, -_DOWNWARD), 0.0)
    targets = np.where(down, points + reach * mirrored, 0.0)
    seen, far = (camera.project(np.moveaxis(of, 0, -1)) for of in (points, targets))
    return seen, far, down


def _dot(a: Float64, b: Float64) -> Float64:
    """Return the products of vectors along the first axis."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


class Quads:
    """Images of one size, as channels: OpenCV samples four channels about as fast as two images.

    Parameters
    ----------
    images
        N images ``(H, W)``.
    """

    def __init__(self, images: Sequence[Float32]) -> None:
        self._shape, self._count = images[0].shape, len(images)
        self._quads = []
        for first in range(0, len(images), _CHANNELS):
            some = list(images[first : first + _CHANNELS])
            # OpenCV rounds the places for two channels.
            some += some[:1] * (_CHANNELS - len(some))
            self._quads.append(cv2.merge(some))

    def at(self, pixels: Floating) -> tuple[Float32, Bool]:
        """Return samples ``(N, H, P)`` at pixels ``(H, P, 2)``, and which are in the images."""
        x, y = (np.ascontiguousarray(pixels[..., axis], np.float32) for axis in (0, 1))
        height, width = self._shape
        inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
        values = np.zeros((_CHANNELS * len(self._quads), *x.shape), np.float32)
        for k, quad in enumerate(self._quads):
            seen = cv2.remap(quad, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            values[_CHANNELS * k : _CHANNELS * (k + 1)] = np.moveaxis(seen, -1, 0)
        return values[: self._count], inside
