"""Super-resolution as a stage: rows of tiles, each of which is computed on its own."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from acquisition import DataError
from acquisition.files import Form, Maps
from processing.detail.separation import sums_of_rows
from processing.noise.normal_errors import UNIFORM_DEG
from processing.stages.stage import Need, NormalRows, Size, Step
from processing.superres.enlarge import (
    REACH_PX,
    HighTile,
    LowMap,
    Span,
    enlarge,
    enlarged_rows,
    margin_rows,
    reached,
    spans,
    tiles,
)
from processing.superres.method import PixelSampling, SuperResolutionMethod
from processing.superres.model import SCALES, SuperResolutionModel, read_superres_model
from processing.superres.network import Network
from rig import MAX_PIXELS
from rig.arrays import AnyArray, Bool, Float32, Float64

Filled = dict[str, AnyArray]

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
    model, network
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
    network: Network | None = field(repr=False)
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
        """Load the network; parameters and errors are those of `super_resolve`.

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
            return cls(scale, False, "area", None, None, max_pixels, mask)
        if isinstance(model, SuperResolutionModel):
            model.check(scale, method)
            used = model
        else:
            used = read_superres_model(model, scale, method)
        turned = scale == _ENSEMBLE_SCALE if self_ensemble is None else self_ensemble
        return cls(scale, turned, sampling, used, Network(used), max_pixels, mask)

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
        wanted = self.wanted
        if wanted is not None and (wanted.dtype != np.bool_ or wanted.shape != size):
            raise DataError(
                f"a mask of {wanted.dtype} and shape {wanted.shape} does not fit: bool of shape "
                f"{size} is required"
            )
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

        def enlarged(rows: slice) -> Iterator[float]:
            for band in bands[rows.start // self.side : -(-rows.stop // self.side)]:
                yield from self._enlarge(maps, low, band)

        return [Step("enlarge", len(low.mask), enlarged, self.side)]

    def _enlarge(self, maps: Maps, given: NormalRows, band: Span) -> Iterator[float]:
        """Fill the maps for a band; yield the share that is done after each tile."""
        scale, mask = self.scale, given.mask
        rows = enlarged_rows(band.core, scale)
        size = rows.stop - rows.start, scale * mask.shape[1]
        made: Filled = {name: np.zeros(*form) for name, form in self._forms(size).items()}
        if "sigma_deg" in made:
            made["sigma_deg"][:] = np.nan
        if reached(mask[band.around])[band.inside].any():
            low = LowMap.of(given.normals, mask, band.around, scale, self.halo, self.sampling)
            own = np.zeros(size, np.float32)
            domain = "normals" if self.model is None else self.model.domain
            work = list(tiles(low.reach, band.inside, self.side, self.halo))
            for number, tile in enumerate(work, 1):
                columns = enlarged_rows(tile.core[1], scale)
                wanted = None if self.wanted is None else self.wanted[rows, columns]
                part = enlarge(low, tile, scale, wanted, self.network, domain, self.self_ensemble)
                _put(made, own, columns, part)
                yield number / len(work)
            made["sums"][:] = _sums(made, own)
        for name, values in made.items():
            maps[name][rows] = values


def _tile_side(halo: int) -> int:
    """Return the side of a tile for a halo, both in pixels of the low resolution."""
    return max(TILE_PX, _HALOS * halo)


def _put(maps: Filled, own: Float32, columns: slice, made: HighTile) -> None:
    """Write a tile into the maps of its rows."""
    part = slice(None), columns
    maps["normals"][part], maps["mask"][part] = made.normals, made.mask
    maps["added_deg"][part] = made.added_deg
    own[part] = made.detail_deg
    squares = made.added_deg**2
    maps["invented"][part] = squares / np.maximum(squares + made.detail_deg**2, np.float32(1e-12))
    if made.variance is not None:
        sigma = np.minimum(
            np.float32(math.degrees(1)) * np.sqrt(made.variance), np.float32(UNIFORM_DEG)
        )
        maps["sigma_deg"][part] = np.where(made.mask, sigma, np.float32(np.nan))


def _sums(maps: Filled, own: Float32) -> Float64:
    mask, added = maps["mask"], maps["added_deg"]
    return np.stack([sums_of_rows(each, mask) for each in (added**2, own**2, added)], axis=1)
