"""Relightable images of a recording, or of normals and albedo."""

from __future__ import annotations

import math
from contextlib import ExitStack
from typing import Any

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Source
from calibration import linear_stack, open_stack
from processing.images.viewing_rays import lights_of, view_of
from processing.maps.normal_map import NormalMap
from processing.relight.relightable_fit import (
    RelightColours,
    RelightFit,
    RelightValues,
    Samples,
    fit_rows,
)
from processing.relight.relightable_image import LightBasis, light_basis
from processing.stereo.light_model import LightModel
from rig import Progress, check_type, no_progress
from rig.arrays import Float32, Float64

# Bytes of a stack that is read at once, as in `reconstruct`.
_IN_MEMORY = 1_000_000_000
# Directions in which a matte surface is shaded, and the height of the lowest one.
_DIRECTIONS = 200
_LOWEST = 0.1


def fit_recording(
    source: Source,
    *,
    basis: LightBasis = "ptm",
    colours: RelightColours = "lrgb",
    values: RelightValues = "display",
    distant: bool = False,
    depth_mm: npt.ArrayLike | None = None,
    height_mm: float = 0.0,
    pixel_mm: float | None = None,
    on_progress: Progress = no_progress,
) -> RelightFit:
    """Fit the images of a recording by functions of the direction of the light.

    The images are made linear as in `linear_stack` and divided by white, the light that 0.1 % of
    the pixels exceed. Saturated and missing samples are left out, those in shadow are not. A
    penalty on the size of the coefficients, 1e-4 of the number of samples, makes the solution
    unique. Samples under near lights are divided by the irradiance at their point, so that the
    result is the image under a distant light.

    Parameters
    ----------
    source
        Source with lights, as returned by `acquisition.read_source`.
    basis
        Functions of the direction, see `light_basis`.
    colours
        ``lrgb``: one function of the luma per pixel and a colour that it is multiplied by.
        ``rgb``: one function per channel.
    values
        ``display``: samples of the sRGB curve, as viewers show them. ``linear``: proportional to
        light.
    distant
        Treat lights with positions as distant lights.
    depth_mm
        ``(H, W)`` distance of the surface from the camera along its axis, for near lights and a
        camera with a working distance; NaN where it is not known: there, the plane of ``height_mm``
        replaces it.
    height_mm
        Mean height of the object above the working plane, for near lights.
    pixel_mm
        Size of a pixel on the object, for near lights without a camera at a known distance.
    on_progress
        Receives the stages ``reading`` and ``fitting``.

    Returns
    -------
    RelightFit
        The image, its deviation from the samples, and figures.

    Raises
    ------
    DataError
        If the source has no lights, or near lights and no scale, or the depth does not fit.
    EstimateError
        If the images are black.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights, read_source, write_png
    >>> from processing.relight import fit_recording
    >>> lights = Lights(directions=np.random.default_rng(0).normal(size=(9, 3)) ** 2)
    >>> for i in range(9):
    ...     write_png(f"card.{i}.png", np.full((4, 5), 40_000, np.uint16))
    >>> fit_recording(read_source(".", lights=lights)).image
    RelightableImage(ptm, LRGB, 5 x 4 px)
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    lights = lights_of(source, distant=distant)
    size = source.size
    points = None
    if lights.near:
        view = view_of(source, pixel_mm)
        points = view.points_at(_depth(depth_mm, view.distance_mm - height_mm, size))
    coloured = source.cfa is not None or len(source.frames[0].shape) == 3
    model = LightModel(lights, points, np.ones(size, np.bool_))
    shared = None if lights.near else light_basis(lights.unit_directions, basis)[None]
    with ExitStack() as opened:
        of_stack: dict[str, Any] = {
            "channel": "rgb" if coloured else "gray",
            "on_progress": on_progress,
        }
        count = len(source.light_ids)
        channels = 3 if coloured else 1
        if 4 * count * channels * math.prod(size) <= _IN_MEMORY:
            stack: Any = linear_stack(source, **of_stack)
        else:
            stack = opened.enter_context(open_stack(source, **of_stack))

        def rows(first: int, last: int) -> Samples:
            linear = stack.rows(first, last).values.reshape(count, -1, channels)
            if shared is not None:
                return Samples(linear, shared)
            pixels = np.arange(first * size[1], last * size[1])
            return _near(linear, model.vectors(pixels).astype(np.float64), basis)

        return fit_rows(
            rows, size, np.asarray(lights.unit_directions, np.float64), channels,
            basis=basis, colours=colours, values=values, on_progress=on_progress,
        )  # fmt: skip


def fit_normals(
    normal_map: NormalMap,
    albedo: npt.ArrayLike,
    *,
    basis: LightBasis = "ptm",
    colours: RelightColours = "lrgb",
    values: RelightValues = "display",
    on_progress: Progress = no_progress,
) -> RelightFit:
    """Fit the shading of a matte surface by functions of the direction of the light.

    The surface is shaded as ``albedo * max(n . l, 0)`` under 200 lights that cover the hemisphere
    evenly. There are no cast shadows and no gloss, and the image is black outside the mask.

    Parameters
    ----------
    normal_map
        Normals of the surface.
    albedo
        ``(H, W)`` or ``(H, W, 3)`` linear values.
    basis, colours, values, on_progress
        As in `fit_recording`.

    Raises
    ------
    DataError
        If the albedo does not fit the normals.
    EstimateError
        If the albedo is 0.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.relight import fit_normals
    >>> facing = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (4, 5, 1)))
    >>> image = fit_normals(facing, np.full((4, 5), 0.5), basis="hsh9", values="linear").image
    >>> image.relit([0, 0, 1])[0, 0].round(2), image.relit([1, 0, 1])[0, 0].round(2)
    (array([1., 1., 1.], dtype=float32), array([0.71, 0.71, 0.71], dtype=float32))
    """
    check_type("normal_map", normal_map, NormalMap, "NormalMap.from_vectors(array) makes one")
    reflectance = np.asarray(albedo, np.float32)
    size = normal_map.size
    if reflectance.shape not in (size, (*size, 3)):
        raise DataError(
            f"an albedo of shape {reflectance.shape} does not fit normals of shape {size}"
        )
    channels = 1 if reflectance.ndim == 2 else 3
    reflectance = np.where(normal_map.mask[..., None], reflectance.reshape(*size, channels), 0)
    directions = _hemisphere()
    shared = light_basis(directions, basis)[None]
    lights = directions.astype(np.float32)

    def rows(first: int, last: int) -> Samples:
        normals = normal_map.normals[first:last].reshape(-1, 3)
        shade = np.maximum(lights @ normals.T, 0)
        return Samples(shade[..., None] * reflectance[first:last].reshape(-1, channels), shared)

    return fit_rows(
        rows, size, directions, channels,
        basis=basis, colours=colours, values=values, on_progress=on_progress,
    )  # fmt: skip


def _depth(depth_mm: npt.ArrayLike | None, plane: float, size: tuple[int, int]) -> Float64:
    depth = np.full(size, plane)
    if depth_mm is not None:
        known = np.asarray(depth_mm, np.float64)
        if known.shape != size:
            raise DataError(f"a depth of shape {known.shape} does not fit images of shape {size}")
        depth = np.where(np.isfinite(known), known, depth)
    return depth


def _near(linear: Float32, vectors: Float64, basis: LightBasis) -> Samples:
    """Divide samples by the irradiance at their points, and evaluate the basis there."""
    strength = np.linalg.norm(vectors, axis=1).T
    reached = strength > 0
    divided = np.full(linear.shape, np.nan, np.float32)
    np.divide(linear, strength[..., None], out=divided, where=reached[..., None])
    directions = np.moveaxis(vectors, 1, 2)
    directions[~reached.T] = [0, 0, 1]
    return Samples(divided, light_basis(directions, basis))


def _hemisphere() -> Float64:
    """Return directions at equal distances, from the lowest height to the pole (golden spiral)."""
    steps = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    w = _LOWEST + (1 - _LOWEST) * steps
    around = np.pi * (1 + np.sqrt(5)) * np.arange(_DIRECTIONS)
    flat = np.sqrt(1 - w * w)
    return np.stack([flat * np.cos(around), flat * np.sin(around), w], axis=-1)
