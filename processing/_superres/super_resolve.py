"""Normal maps of a higher resolution: shape by interpolation, detail by a network."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._normal_map import NormalMap, check_normal_map
from processing._stages.stage import computed
from processing._superres.method import PixelSampling, SuperResolutionMethod
from processing._superres.model import SuperResolutionModel
from processing._superres.super_resolution import SuperResolution
from processing._superres.super_resolution_stage import SuperResolutionStage
from rig import MAX_PIXELS, Progress, no_progress

Mask = npt.NDArray[np.bool_]


def super_resolve(
    normal_map: NormalMap,
    scale: int,
    *,
    method: SuperResolutionMethod | None = None,
    model: str | Path | SuperResolutionModel | None = None,
    self_ensemble: bool | None = None,
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
        times the computing time. Default: at scale 4.
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
        Receives the stage ``super-resolution``, in rows.

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
    stage = SuperResolutionStage.of(
        scale,
        method=method,
        model=model,
        self_ensemble=self_ensemble,
        sampling=sampling,
        mask=mask,
        max_pixels=max_pixels,
    )
    try:
        made = SuperResolution(computed(stage, normal_map, on_progress=on_progress), stage)
    except MemoryError as error:
        height, width = (scale * length for length in normal_map.size)
        raise DataError(
            f"a map of {width} x {height} pixels does not fit into the memory: it needs "
            f"{25 * width * height / 1e9:.1f} GB; use a part of the map"
        ) from error
    if not made.mask.any():
        raise DataError("the mask of the higher resolution has no pixel near the normal map")
    return made
