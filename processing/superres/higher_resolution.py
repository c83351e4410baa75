"""Normal maps of a higher resolution: shape by interpolation, detail by a network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from acquisition import DataError, MapRows
from acquisition.files import rows_in_bands
from processing.maps.normal_map import NormalMap, check_normal_map
from processing.stages.stage import computed
from processing.superres.method import PixelSampling, SuperResolutionMethod
from processing.superres.model import SuperResolutionModel
from processing.superres.super_resolution_stage import SuperResolutionStage
from rig import MAX_PIXELS, Progress, no_progress
from rig.arrays import Bool, Float32, UInt32

# Pixels that are read at once.
_READ = 1 << 20
_HALF = 1 << 16


@dataclass(frozen=True, eq=False)
class SuperResolution:
    """A normal map of a higher resolution.

    Parameters
    ----------
    maps
        The maps ``normals`` ``(H, W, 3)``, ``mask`` ``(H, W)``, and those that the properties
        describe, in memory or in files.
    stage
        How they were computed.
    """

    maps: Mapping[str, MapRows]
    stage: SuperResolutionStage

    def __repr__(self) -> str:
        height, width = self.mask.shape
        count = np.count_nonzero(self.mask)
        made = f"NormalMap(float32[{height}, {width}, 3], {count} normals)"
        return f"SuperResolution({made}, {self.stage.method}, x{self.stage.scale})"

    @cached_property
    def mask(self) -> Bool:
        """``(H, W)`` bool, the pixels with a normal."""
        return self.maps["mask"][:]

    @cached_property
    def normal_map(self) -> NormalMap:
        """The map."""
        return NormalMap.of_unit_vectors(self.maps["normals"][:], self.mask)

    @property
    def sigma_deg(self) -> Float32 | None:
        """``(H, W)`` predicted root mean square angle to the true normal at this resolution.

        NaN outside the mask; None for bicubic interpolation, which predicts none.
        """
        return self.maps["sigma_deg"][:] if "sigma_deg" in self.maps else None

    @property
    def added_deg(self) -> Float32:
        """``(H, W)`` angle between the map and interpolation without a network, 0 outside."""
        return self.maps["added_deg"][:]

    @property
    def invented(self) -> Float32:
        """``(H, W)`` share of the detail of each pixel that the network added.

        The square of `added_deg` relative to its sum with the square of the angle between
        interpolation and shape component; 0 to 1, and 0 outside the mask.
        """
        return self.maps["invented"][:]

    @property
    def invented_share(self) -> float:
        """The same ratio of the means over the mask."""
        sums = self.maps["sums"][:]
        added, own = sums[:, 0].sum(), sums[:, 1].sum()
        return float(added / (added + own)) if added else 0.0

    @cached_property
    def median_sigma_deg(self) -> float:
        """Median of `sigma_deg` over the mask, NaN for bicubic interpolation."""
        if "sigma_deg" not in self.maps:
            return float("nan")
        return _median_of_rows(self.maps["sigma_deg"], self.mask)

    @property
    def mean_added_deg(self) -> float:
        """Mean of `added_deg` over the mask."""
        return float(self.maps["sums"][:][:, 2].sum() / np.count_nonzero(self.mask))


def _median_of_rows(values: MapRows, mask: Bool) -> float:
    """Return the median of a map over a mask, exactly, from bands of rows.

    The bits of positive numbers have the order of the numbers: the upper half of those of the
    median is counted first, then the lower half.

    Parameters
    ----------
    values
        ``(H, W)`` float32, 0 or above inside the mask.
    mask
        ``(H, W)`` bool, not empty.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.superres.higher_resolution import median_of_rows
    >>> median_of_rows(np.float32([[3, 1], [8, 2]]), np.ones((2, 2), bool))
    2.5
    """
    count = np.count_nonzero(mask)
    upper = np.zeros(_HALF, np.int64)
    for bits in _bits(values, mask):
        upper += np.bincount(bits >> 16, minlength=_HALF)
    below = np.cumsum(upper)
    middle = []
    # One value in the middle, or two whose mean is the median.
    for number in ((count - 1) // 2, count // 2):
        top = int(np.searchsorted(below, number, side="right"))
        lower = np.zeros(_HALF, np.int64)
        for bits in _bits(values, mask):
            lower += np.bincount(bits[bits >> 16 == top] & (_HALF - 1), minlength=_HALF)
        rest = number - (below[top] - upper[top])
        middle.append(top << 16 | int(np.searchsorted(np.cumsum(lower), rest, side="right")))
    return float(np.median(np.array(middle, np.uint32).view(np.float32)))


def _bits(values: MapRows, mask: Bool) -> Iterator[UInt32]:
    height, width = mask.shape
    for rows in rows_in_bands(height, width, _READ):
        yield values[rows][mask[rows]].view(np.uint32)


def super_resolve(
    normal_map: NormalMap,
    scale: int,
    *,
    method: SuperResolutionMethod | None = None,
    model: str | Path | SuperResolutionModel | None = None,
    self_ensemble: bool | None = None,
    sampling: PixelSampling = "area",
    mask: Bool | None = None,
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
