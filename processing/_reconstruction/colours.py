"""Normals from images in colour, one solution per channel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Lights
from calibration import EstimateError, StackNoise, luma
from processing._normal_map import NormalMap
from processing._stereo.method import Method
from processing._stereo.photometric_stereo import PhotometricStereoResult, photometric_stereo
from rig import Notice, Progress

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Red, green, blue.
_CHANNELS = 3
_ROWS = 64


def stereo_of_colours(
    values: Float,
    lights: Lights,
    mask: Mask,
    *,
    method: Method,
    points_mm: npt.NDArray[np.float64] | None,
    noise: StackNoise | None,
    camera: CameraModel | None = None,
    on_progress: Progress,
) -> tuple[PhotometricStereoResult, Float]:
    """Solve every channel on its own, and average the normals.

    The weight of a channel at a pixel is the inverse relative variance ``s^2 / variance`` of its
    mean sample s, by the law of the noise under the first light. If the noise is unknown, it is s:
    the variance of shot noise is proportional to the signal. The albedo would be no such measure,
    since a channel that only has noise may have any.

    Parameters
    ----------
    values
        ``(N, H, W, 3)`` linear radiance.
    lights, mask, method, points_mm, camera, on_progress
        As in `photometric_stereo`.
    noise
        Law of the noise of the values; None if it is unknown.

    Returns
    -------
    tuple[PhotometricStereoResult, Float]
        Averaged normals, with the luma of the albedos and of the residuals, and the samples of the
        channel with the fewest; the albedo ``(H, W, 3)``.

    Raises
    ------
    EstimateError
        If no channel determines a normal.
    """
    normals = np.zeros((*mask.shape, 3), np.float32)
    albedo = np.zeros((*mask.shape, _CHANNELS), np.float32)
    residual = np.zeros_like(albedo)
    used = np.full(mask.shape, np.iinfo(np.uint16).max, np.uint16)
    solved: list[tuple[int, PhotometricStereoResult]] = []
    unsolved: list[EstimateError] = []
    for channel in range(_CHANNELS):

        def of_channel(stage: str, done: int, total: int, before: int = channel) -> None:
            on_progress(stage, before * total + done, _CHANNELS * total)

        try:
            one = photometric_stereo(
                values[..., channel],
                lights,
                mask,
                method=method,
                points_mm=points_mm,
                noise=None if noise is None else noise.of_colour(channel),
                camera=camera,
                on_progress=of_channel,
            )
        except EstimateError as error:
            unsolved.append(error)
            continue
        solved.append((channel, one))
        albedo[..., channel], residual[..., channel] = one.albedo, one.residual
        np.minimum(used, one.used, out=used)
    if not solved:
        raise unsolved[0]
    weights = _weights(values, noise)
    for channel, one in solved:
        normals += one.normal_map.normals * weights[..., channel, None]
    length = np.linalg.norm(normals, axis=2)
    known = length > 0
    normals = np.divide(normals, length[..., None], out=normals, where=known[..., None])
    albedo[~known] = 0
    lost = int(np.count_nonzero(mask & ~known))
    return (
        PhotometricStereoResult(
            NormalMap(normals, known),
            luma(albedo),
            luma(residual),
            used,
            (Notice("pixels-without-normal", _lost(lost, mask)),) if lost else (),
        ),
        albedo,
    )


def _weights(values: Float, noise: StackNoise | None) -> Float:
    weights: Float = np.zeros(values.shape[1:], np.float32)
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


def _lost(lost: int, mask: Mask) -> str:
    return (
        f"{lost} of {np.count_nonzero(mask)} pixels of the mask "
        f"{'has' if lost == 1 else 'have'} no normal in any channel: black, or too few usable "
        "samples"
    )
