"""Normals from images in colour, one solution per channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from acquisition import CameraModel, Lights
from calibration import StackNoise
from calibration.radiance import luma
from processing.stereo.frames import Frames
from processing.stereo.image_noise import NoiseLaw, law_of_images
from processing.stereo.light_model import LightModel
from processing.stereo.method import Method
from processing.stereo.solve import solve_maps
from processing.stereo.stereo_maps import StereoMaps
from rig import no_progress
from rig.arrays import Bool, Float32, Float64, Intp, UInt16

# Red, green, blue.
_CHANNELS = 3
_ROWS = 64


@dataclass(frozen=True, eq=False)
class ColourImages:
    """Images in colour, or some rows of them.

    Parameters
    ----------
    values
        ``(N, H, W, 3)`` linear radiance. Samples that are not finite are left out.
    lights, mask, points_mm
        As in `photometric_stereo`.
    noise
        Law of the noise of the values; None if it is unknown.
    camera, rows
        Camera, and the rows of its image; None for all.
    """

    values: Float32
    lights: Lights
    mask: Bool
    points_mm: Float64 | None
    noise: StackNoise | None
    camera: CameraModel | None = None
    rows: Intp | None = None

    @property
    def model(self) -> LightModel:
        """Light vectors at the pixels."""
        return LightModel(self.lights, self.points_mm, self.mask)

    def solved(
        self, samples: Float32, law: NoiseLaw | Float32 | None, method: Method
    ) -> StereoMaps:
        """Return the maps of samples ``(N, H, W)`` made from these images."""
        maps, frames = StereoMaps.empty(self.mask.shape), Frames(samples)
        solve_maps(
            frames, self.model, self.mask, law, method, maps, self.camera, no_progress, self.rows
        )
        return maps


@dataclass(frozen=True, eq=False)
class ColourMaps:
    """Maps of images in colour with S solutions: one for each colour, or one of all.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit normals; 0 at pixels without a normal.
    albedo
        ``(H, W, 3)``.
    residual
        ``(H, W)``, luma of the residuals.
    used
        ``(S, H, W)`` uint16, number of samples.
    solved
        ``(S,)`` bool, whether a solution has any normal.
    """

    normals: Float32
    albedo: Float32
    residual: Float32
    used: UInt16
    solved: Bool

    @classmethod
    def empty(cls, shape: tuple[int, ...], solutions: int) -> Self:
        """Return maps of 0."""
        return cls(
            np.zeros((*shape, 3), np.float32),
            np.zeros((*shape, 3), np.float32),
            np.zeros(shape, np.float32),
            np.zeros((solutions, *shape), np.uint16),
            np.zeros(solutions, np.bool_),
        )

    def write(self, rows: slice, part: ColourMaps, inside: slice) -> None:
        """Copy rows of other maps."""
        self.normals[rows] = part.normals[inside]
        self.albedo[rows] = part.albedo[inside]
        self.residual[rows] = part.residual[inside]
        self.used[:, rows] = part.used[:, inside]
        self.solved[:] |= part.solved

    def fewest_used(self) -> UInt16:
        """Return the samples of the solution with the fewest.

        Solutions that have no normal at all do not count.
        """
        used: UInt16 = self.used[self.solved if self.solved.any() else slice(0, 1)].min(axis=0)
        return used


def laws_of_colours(images: ColourImages, method: Method) -> list[Float32 | None]:
    """Return the law of each channel that images show, see `law_of_images`, if it is needed."""
    if method == "ls" or images.noise is not None:
        return [None] * _CHANNELS
    model = images.model
    return [
        law_of_images(Frames(np.ascontiguousarray(images.values[..., k])), model, images.mask)
        for k in range(_CHANNELS)
    ]


def solve_colours(
    images: ColourImages, method: Method, laws: Sequence[Float32 | None]
) -> ColourMaps:
    """Solve every channel on its own, and average the normals.

    The weight of a channel at a pixel is the inverse relative variance ``s^2 / variance`` of its
    mean sample s, by the law of the noise under the first light. If the noise is unknown, it is s:
    the variance of shot noise is proportional to the signal. The albedo would be no such measure,
    since a channel that only has noise may have any.

    Parameters
    ----------
    images
        The images.
    method
        Method of `photometric_stereo`.
    laws
        What `laws_of_colours` has returned for these or other rows.
    """
    noise = images.noise
    found = ColourMaps.empty(images.mask.shape, _CHANNELS)
    weights = _weights(images.values, noise)
    residual = np.zeros_like(found.albedo)
    for channel, estimated in enumerate(laws):
        stack = np.ascontiguousarray(images.values[..., channel])
        law: NoiseLaw | Float32 | None = estimated
        if noise is not None:
            law = NoiseLaw(noise.of_colour(channel), stack.shape)
        maps = images.solved(stack, law, method)
        found.normals[:] += maps.normals * weights[..., channel, None]
        found.albedo[..., channel], residual[..., channel] = maps.albedo, maps.residual
        found.used[channel] = maps.used
        found.solved[channel] = maps.albedo.any()
    length = np.linalg.norm(found.normals, axis=2)
    known = length > 0
    np.divide(found.normals, length[..., None], out=found.normals, where=known[..., None])
    found.albedo[~known] = 0
    found.residual[:] = luma(residual)
    return found


def _weights(values: Float32, noise: StackNoise | None) -> Float32:
    weights: Float32 = np.zeros(values.shape[1:], np.float32)
    for top in range(0, values.shape[1], _ROWS):
        rows = values[:, top : top + _ROWS]
        measured = np.isfinite(rows)
        signal = np.sum(rows, axis=0, where=measured) / np.maximum(measured.sum(axis=0), 1)
        signal = np.maximum(signal, 0)
        variance = signal if noise is None else noise.variance(0, signal, top)
        np.divide(
            signal**2, variance, out=weights[top : top + _ROWS], where=signal > 0, casting="unsafe"
        )
    return weights
