"""Normals from the frames of a camera, without files, for inspection lines."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Lights
from processing.maps.normal_map import check_mask
from processing.stereo.frames import Frames
from processing.stereo.image_noise import law_of_images
from processing.stereo.light_model import LightModel, check_one_light_each
from processing.stereo.method import Estimator, method_name
from processing.stereo.solve import solve_maps
from processing.stereo.stereo_maps import StereoMaps
from rig import check_type, no_progress, pluralize
from rig.arrays import AnyArray, Bool, Float32, Float64

Region = tuple[int, int, int, int]


def normals_of_frames(
    frames: AnyArray,
    lights: Lights,
    *,
    dark: npt.ArrayLike = 0.0,
    gain: npt.ArrayLike = 1.0,
    saturation: float = np.inf,
    region: Region | None = None,
    mask: Bool | None = None,
    method: str | Estimator = "ls",
    points_mm: npt.ArrayLike | None = None,
    out: StereoMaps | None = None,
) -> StereoMaps:
    """Estimate normals from the frames of a linear camera, which are read in place.

    A sample is ``(frame - dark) * gain / intensity`` of its light. Nothing is copied if the samples
    of a row are next to each other in memory: ``ls`` then needs no memory besides the maps.
    `photometric_stereo` returns the same for frames that were converted before.

    Parameters
    ----------
    frames
        ``(N, H, W)`` uint8, uint16 or float32 samples, proportional to light above the dark level;
        other types are converted. Samples that are not finite are left out.
    lights
        The N lights in the order of the frames.
    dark
        Dark level in the unit of the frames: one number, or ``(H, W)``.
    gain
        Factor of all frames, for example the reciprocal of the exposure time, or ``(N,)``.
    saturation
        Samples from this value on are left out, for example 4095 for 12 bits.
    region
        Column and row of the first pixel, width and height of the part to compute; None for all.
    mask
        ``(H, W)`` bool, the pixels to compute; None for all.
    method
        As in `photometric_stereo`.
    points_mm
        ``(H, W, 3)`` surface points, for lights with positions.
    out
        Maps of the size of the region, which are overwritten; None for new ones.

    Returns
    -------
    StereoMaps
        Maps of the region: ``out``, if it was given. Pixels without a normal are 0.

    Raises
    ------
    DataError
        If shapes or counts differ, the region is not inside the frames, a number is not usable, or
        near lights have no points.
    EstimateError
        If there are fewer than 3 lights, or the lights are in one plane.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from processing import normals_of_frames
    >>> lights = Lights(directions=[[1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1]])
    >>> shading = lights.unit_directions @ [0.0, 0.6, 0.8]
    >>> frames = np.zeros((4, 480, 640), np.uint16) + np.uint16(3000 * shading + 64)[:, None, None]
    >>> maps = normals_of_frames(frames, lights, dark=64, saturation=4095, region=(20, 10, 200, 90))
    >>> maps.normals.shape, maps.normals[0, 0].round(3)
    ((90, 200, 3), array([0. , 0.6, 0.8], dtype=float32))
    """
    check_type("lights", lights, Lights, "Lights(directions)")
    if isinstance(frames, np.ma.MaskedArray):
        raise TypeError("frames must not be a masked array: give frames.filled(saturation)")
    frames, dark = np.asarray(frames), np.asarray(dark, np.float32)
    name = method_name(method)
    _check(frames, lights, dark, saturation)
    factor = _factors(gain, len(lights))
    rows, columns = _inside(region, frames.shape[1:])
    part = frames[:, rows, columns]
    shape = part.shape[1:]
    maps = StereoMaps.empty(shape) if out is None else out
    check_type("out", maps, StereoMaps, "StereoMaps.empty((rows, columns))")
    maps.check(shape)
    if mask is not None:
        mask = check_mask("mask", mask, frames.shape[1:])[rows, columns]
    of_part = check_mask("mask", mask, shape)
    if not of_part.any():
        raise DataError("the mask has no pixel in the region: there is nothing to compute")
    points = None
    if points_mm is not None and lights.near:
        whole = np.asarray(points_mm)
        if whole.shape != (*frames.shape[1:], 3):
            raise DataError(
                f"points of shape {whole.shape} do not fit frames of {_size(frames.shape[1:])}"
            )
        points = whole[rows, columns]
    model = LightModel(lights, points, of_part)
    model.check(of_part)
    images = Frames(
        part,
        gain=factor / model.intensities,
        dark=dark if dark.ndim == 0 else dark[rows, columns],
        limit=saturation,
    )
    if out is not None:
        maps.clear()
    law = None if name == "ls" else law_of_images(images, model, of_part)
    solve_maps(images, model, of_part, law, name, maps, None, no_progress)
    return maps


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]} px"


def _check(
    frames: AnyArray,
    lights: Lights,
    dark: Float32,
    saturation: float,
) -> None:
    if frames.ndim != 3 or frames.dtype.kind not in "uif":
        raise DataError(
            f"frames are numbers of shape (N, H, W), not {frames.dtype} of shape {frames.shape}"
        )
    check_one_light_each(len(frames), lights, "frame")
    size = frames.shape[1:]
    if dark.ndim and dark.shape != size:
        raise DataError(f"a dark image of shape {dark.shape} does not fit frames of {_size(size)}")
    if not np.isfinite(dark).all():
        raise DataError("the dark level is not finite")
    if not saturation > float(dark.min()):
        raise DataError(f"a saturation of {saturation:g} is not above the dark level")


def _factors(gain: npt.ArrayLike, lights: int) -> Float64:
    factor = np.asarray(gain, np.float64)
    if factor.shape not in ((), (lights,)):
        raise DataError(f"a gain of shape {factor.shape} does not fit {pluralize(lights, 'frame')}")
    if not (np.isfinite(factor) & (factor > 0)).all():
        raise DataError("a gain is not a finite number above 0")
    return np.broadcast_to(factor, (lights,))


def _inside(region: Region | None, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of a region."""
    if region is None:
        return slice(None), slice(None)
    x, y, width, height = region
    if x < 0 or y < 0 or width < 1 or height < 1 or x + width > shape[1] or y + height > shape[0]:
        raise DataError(
            f"the region x {x}, y {y}, {_size((height, width))} is not inside frames of "
            f"{_size(shape)}"
        )
    return slice(y, y + height), slice(x, x + width)
