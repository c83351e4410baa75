"""Normal maps of a higher resolution: shape by interpolation, detail by a network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from acquisition import DataError, MapRows
from acquisition.files import Form, Maps, rows_in_bands
from processing.detail.separation import sums_of_rows
from processing.maps.normal_map import NormalMap, check_mask, check_normal_map
from processing.stages.stage import Need, NormalRows, Size, Step, computed
from processing.superres.enlarge import (
    REACH_PX,
    LowMap,
    Span,
    enlarge,
    enlarged_rows,
    margin_rows,
    reached,
    spans,
)
from processing.superres.method import PixelSampling, SuperResolutionMethod
from processing.superres.model import SCALES, SuperResolutionModel, read_superres_model
from processing.superres.network import Network
from rig import MAX_PIXELS, Progress, no_progress
from rig.arrays import AnyArray, Bool, Float32, UInt32

# Pixels that are read at once.
_READ = 1 << 20
_HALF = 1 << 16
# Side of a tile in pixels of the low resolution, and its least ratio to the halo.
TILE_PX, _HALOS = 128, 2
# The interpreter, libraries, compiled kernels and a network with the features of a tile.
_FIXED = 450_000_000
# Bytes per pixel of the high resolution: a result in memory with what is written of it, masks while
# the maps are on disk, and the rows of tiles that are computed together.
_WHOLE, _ON_DISK, _OF_BAND = 30, 2, 36
# Bytes per pixel of the low resolution: a map in memory, a mask, and rows of tiles with halos.
_MAP, _MASK, _OF_LOW_BAND = 13, 2, 60
# At scale 2, turned copies take more than 20 CPU s for 1 million pixels.
_ENSEMBLE_SCALE = 4
_SUMS = 3


@dataclass(frozen=True, eq=False)
class SuperResolutionStage:
    """The enlargement of a normal map.

    The maps are those of `SuperResolution`, and ``sums``: of each row, the sum of the squares of
    ``added_deg`` and of the detail of an interpolation, and of ``added_deg``.

    Parameters
    ----------
    scale
        Factor of the resolution.
    self_ensemble
        Whether the mean of turned copies is used.
    sampling
        What the normals of the map are.
    model
        The network; None for bicubic interpolation.
    max_pixels
        Largest number of pixels of the result.
    wanted
        The mask of `super_resolve`.
    """

    name: ClassVar = "super-resolution"

    scale: int
    self_ensemble: bool
    sampling: PixelSampling
    model: SuperResolutionModel | None = field(repr=False)
    max_pixels: int = field(default=MAX_PIXELS, repr=False)
    wanted: Bool | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls,
        scale: int,
        *,
        method: SuperResolutionMethod | None = None,
        model: str | Path | SuperResolutionModel | None = None,
        self_ensemble: bool | None = None,
        sampling: PixelSampling = "area",
        mask: Bool | None = None,
        max_pixels: int = MAX_PIXELS,
    ) -> SuperResolutionStage:
        """Read and try the network; parameters and errors are those of `super_resolve`.

        Examples
        --------
        >>> from processing.superres import SuperResolutionStage
        >>> SuperResolutionStage.of(4, method="bicubic").method
        'bicubic'
        """
        if scale not in SCALES:
            raise DataError(f"a scale of {scale} is not available: use 2 or 4")
        if method == "bicubic":
            if model is not None or self_ensemble:
                raise DataError("bicubic interpolation uses no network: leave out the network")
            return cls(scale, False, "area", None, max_pixels, mask)
        if isinstance(model, SuperResolutionModel):
            model.check(scale, method)
            used = model
        else:
            used = read_superres_model(model, scale, method)
        turned = scale == _ENSEMBLE_SCALE if self_ensemble is None else self_ensemble
        Network(used)  # it is loaded again by the steps, and not kept longer than they are
        return cls(scale, turned, sampling, used, max_pixels, mask)

    @property
    def method(self) -> SuperResolutionMethod:
        """How the map is made."""
        return "bicubic" if self.model is None else self.model.domain

    @property
    def halo(self) -> int:
        """How far a result depends on its surroundings, in pixels of the low resolution."""
        return REACH_PX if self.model is None else max(self.model.halo_px, REACH_PX)

    @property
    def side(self) -> int:
        """Side of a tile in pixels of the low resolution."""
        return _tile_side(self.halo)

    def need(self, *sizes: Size) -> Need:
        """Return the memory for a map of (height, width)."""
        ((height, width),) = sizes
        # Without a network, what it would need is reserved, too.
        halo = 19 if self.model is None else self.model.halo_px
        rows, finer = _tile_side(halo), self.scale**2
        read = min(rows + 2 * (halo + margin_rows(halo)), height)
        band = width * (read * _OF_LOW_BAND + finer * min(rows, height) * _OF_BAND)
        return Need(
            _FIXED + band + height * width * (_MAP + finer * _WHOLE),
            _FIXED + band + height * width * (_MASK + finer * _ON_DISK),
            f"a normal map of {width} x {height} pixels at scale {self.scale}",
        )

    def forms(self, *sizes: Size) -> Mapping[str, Form]:
        """Return shapes and types of the maps.

        Raises
        ------
        DataError
            If the result has more pixels than are allowed, or the mask does not fit.
        """
        (low,) = sizes
        height, width = size = self.scale * low[0], self.scale * low[1]
        if height * width > self.max_pixels:
            raise DataError(
                f"scale {self.scale} turns {low[1]} x {low[0]} pixels into {width} x {height}, "
                f"{self.max_pixels} are allowed: use a part of the map, or raise the limit on "
                "pixels"
            )
        check_mask("mask", self.wanted, size)
        return self._forms(size)

    def _forms(self, size: Size) -> dict[str, Form]:
        plain = (size, np.float32)
        maps: dict[str, Form] = {
            "normals": ((*size, 3), np.float32),
            "mask": (size, np.bool_),
            "added_deg": plain,
            "invented": plain,
            "sums": ((size[0], _SUMS), np.float64),
        }
        return maps if self.model is None else maps | {"sigma_deg": plain}

    def steps(self, maps: Maps, *inputs: NormalRows, memory: int | None = None) -> list[Step]:
        """Return the one step, over the rows of the given map; bands are rows of tiles."""
        (low,) = inputs
        bands = spans(len(low.mask), self.side, self.halo)
        network = None if self.model is None else Network(self.model, tried=True)

        def enlarged(rows: slice) -> Iterator[float]:
            for band in bands[rows.start // self.side : -(-rows.stop // self.side)]:
                yield from self._enlarge(maps, low, band, network)

        return [Step("enlarge", len(low.mask), enlarged, self.side)]

    def _enlarge(
        self, maps: Maps, given: NormalRows, band: Span, network: Network | None
    ) -> Iterator[float]:
        """Fill the maps for a band; yield the share that is done after each tile."""
        scale, mask = self.scale, given.mask
        rows = enlarged_rows(band.core, scale)
        size = rows.stop - rows.start, scale * mask.shape[1]
        made: dict[str, AnyArray] = {
            name: np.zeros(*form) for name, form in self._forms(size).items()
        }
        if "sigma_deg" in made:
            made["sigma_deg"][:] = np.nan
        if reached(mask[band.around])[band.inside].any():
            low = LowMap.of(given.normals, mask, band.around, scale, self.halo, self.sampling)
            made["detail_deg"] = np.zeros(size, np.float32)
            domain = "normals" if self.model is None else self.model.domain
            inner, width = band.inside, mask.shape[1]
            work = [
                columns
                for columns in spans(width, self.side, self.halo)
                if low.reach[inner, columns.core].any()
            ]
            for number, columns in enumerate(work, 1):
                part = enlarged_rows(columns.core, scale)
                wanted = None if self.wanted is None else self.wanted[rows, part]
                for name, values in enlarge(
                    low, inner, columns, scale, wanted, network, domain, self.self_ensemble
                ).items():
                    made[name][:, part] = values
                yield number / len(work)
            added, own, inside = made["added_deg"], made.pop("detail_deg"), made["mask"]
            sums = [sums_of_rows(each, inside) for each in (added**2, own**2, added)]
            made["sums"][:] = np.stack(sums, axis=1)
        for name, values in made.items():
            maps[name][rows] = values


def _tile_side(halo: int) -> int:
    """Return the side of a tile for a halo, both in pixels of the low resolution."""
    return max(TILE_PX, _HALOS * halo)


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
