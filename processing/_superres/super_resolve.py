"""Normal maps of a higher resolution: shape by interpolation, detail by a network."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._normal_map import NormalMap, check_normal_map
from processing._superres.enlarge import HighMap, LowMap, enlarge
from processing._superres.interpolation import REACH_PX
from processing._superres.model import SCALES, SuperResolutionModel, read_superres_model
from processing._superres.network import Network
from processing._superres.super_resolution import (
    PixelSampling,
    SuperResolution,
    SuperResolutionMethod,
)
from processing._superres.tiles import tiles
from rig import MAX_PIXELS, Progress, no_progress

Mask = npt.NDArray[np.bool_]

# Side of a tile in pixels of the low resolution, and its least ratio to the halo.
TILE_PX, _HALOS = 128, 2


def super_resolve(
    normal_map: NormalMap,
    scale: int,
    *,
    method: SuperResolutionMethod | None = None,
    model: str | Path | SuperResolutionModel | None = None,
    self_ensemble: bool = False,
    sampling: PixelSampling = "area",
    mask: Mask | None = None,
    max_pixels: int = MAX_PIXELS,
    on_progress: Progress = no_progress,
) -> SuperResolution:
    """Enlarge a normal map; a network adds detail where it expects to be right.

    With the method ``detail``, the shape component is interpolated bicubically, the detail is
    enlarged by a network and both are combined again, as in the paper's surface super-resolution.
    With ``normals``, the network enlarges the normals themselves. The network predicts its
    mean-square error and that of bicubic interpolation; its result counts less where it expects to
    be worse, and where the map is smooth. The rest is interpolated, more accurately than by bicubic
    interpolation: by cubic convolution over six pixels of the normals at their centres, of which
    the given ones are means. The result keeps the given normals, as means or at the centres.

    Parameters
    ----------
    normal_map
        The map of the low resolution, of any size. It is continued beyond its mask before it is
        interpolated, so that no background enters.
    scale
        Factor of the resolution, 2 or 4.
    method
        ``detail``, ``normals``, or ``bicubic`` for interpolation without a network, as OpenCV and
        torch have it (a = -0.75). Default: that of the network.
    model
        The network: a name, the path of a ``.onnx`` file, or what `read_superres_model` returned.
        Default: the one that comes with the program.
    self_ensemble
        Average the results of the 8 mirrored and turned copies of the map: more accurate, and eight
        times the computing time.
    sampling
        What the normals are: ``area`` for the mean over each pixel, as a camera records it, or
        ``points`` for the normal at its centre, as a projection or a rendering draws it. Points
        are averaged over their pixels first; bicubic interpolation uses both as they are.
    mask
        ``(scale H, scale W)`` bool, a mask of the higher resolution. It counts up to one low pixel
        beyond the mask of the map. Default: the mask of the map, with a smooth outline.
    max_pixels
        Largest number of pixels of the result.
    on_progress
        Receives the stage ``super-resolution``, in tiles.

    Returns
    -------
    SuperResolution
        The map, its standard deviations and what was invented. It does not depend on the number of
        threads.

    Raises
    ------
    DataError
        If the scale is neither 2 nor 4, the result would be too large, the mask does not fit, or
        the network is damaged, unknown, or for another scale or domain.
    MissingPathError
        If a file of the network does not exist.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, super_resolve
    >>> y, x = np.mgrid[1:-1:24j, -1:1:32j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> super_resolve(bowl, 4, method="bicubic")
    SuperResolution(NormalMap(float32[96, 128, 3], 12288 normals), bicubic, x4)
    """
    check_normal_map("normal_map", normal_map)
    high = _allocated(normal_map.size, scale, max_pixels)
    if mask is not None and (mask.dtype != np.bool_ or mask.shape != high.mask.shape):
        raise DataError(
            f"a mask of {mask.dtype} and shape {mask.shape} does not fit: bool of shape "
            f"{high.mask.shape} is required"
        )
    used, network, halo = None, None, REACH_PX
    if method == "bicubic":
        if model is not None or self_ensemble:
            raise DataError("bicubic interpolation uses no network: leave out the network")
    else:
        if isinstance(model, SuperResolutionModel):
            used = model
            used.check(scale, method)
        else:
            used = read_superres_model(model, scale, method)
        network, halo = Network(used), max(used.halo_px, REACH_PX)
    low = LowMap.of(normal_map, scale, halo, "area" if used is None else sampling)
    domain = "normals" if used is None else used.domain
    parts = list(tiles(low.reach, max(TILE_PX, _HALOS * halo), halo))
    on_progress("super-resolution", 0, len(parts))
    for done, tile in enumerate(parts):
        enlarge(low, tile, scale, mask, network, domain, self_ensemble, high)
        on_progress("super-resolution", done + 1, len(parts))
    if not high.mask.any():
        raise DataError("the mask of the higher resolution has no pixel near the normal map")
    return _result(high, scale, used)


def _allocated(size: tuple[int, int], scale: int, max_pixels: int) -> HighMap:
    """Return an empty map of the higher resolution, or raise `DataError`."""
    if scale not in SCALES:
        raise DataError(f"a scale of {scale} is not available: use 2 or 4")
    height, width = (scale * length for length in size)
    if height * width > max_pixels:
        raise DataError(
            f"scale {scale} turns {size[1]} x {size[0]} pixels into {width} x {height}, "
            f"{max_pixels} are allowed: use a part of the map, or raise the limit on pixels"
        )
    try:
        return HighMap.empty((height, width))
    except MemoryError as error:
        raise DataError(
            f"a map of {width} x {height} pixels does not fit into the memory: it needs "
            f"{25 * width * height / 1e9:.1f} GB; use a part of the map"
        ) from error


def _result(high: HighMap, scale: int, model: SuperResolutionModel | None) -> SuperResolution:
    mask = high.mask
    added, own = high.added_deg, high.detail_deg
    squares = added**2
    sums = float(np.sum(squares[mask], dtype=np.float64))
    owns = float(np.sum(own[mask].astype(np.float64) ** 2))
    squares /= np.maximum(squares + own**2, np.float32(1e-12))
    sigma = None
    if model is not None:
        sigma = np.where(mask, np.float32(math.degrees(1)) * np.sqrt(high.variance), np.nan)
    return SuperResolution(
        NormalMap.of_unit_vectors(high.normals, mask),
        None if sigma is None else np.asarray(sigma, np.float32),
        added,
        squares,
        sums / (sums + owns) if sums else 0.0,
        "bicubic" if model is None else model.domain,
        scale,
        model,
    )
