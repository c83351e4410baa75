"""How a normal map is enlarged: in rows of tiles, each of which is computed on its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from acquisition import DataError, MapRows
from processing._detail.separation import sums_of_rows
from processing._superres.enlarge import HighTile, LowMap, enlarge, reached
from processing._superres.interpolation import REACH_PX
from processing._superres.model import SCALES, SuperResolutionModel, read_superres_model
from processing._superres.network import Network
from processing._superres.super_resolution import PixelSampling, SuperResolutionMethod
from processing._superres.tiles import Span, enlarged_rows, spans, tiles
from processing._uncertainty.normal_uncertainty import UNIFORM_DEG

Mask = npt.NDArray[np.bool_]
Maps = dict[str, npt.NDArray[Any]]

# Side of a tile in pixels of the low resolution, and its least ratio to the halo.
TILE_PX, _HALOS = 128, 2
# At scale 2, turned copies take more than 20 CPU s for 1 million pixels.
_ENSEMBLE_SCALE = 4
_SUMS = 3


def tile_side(halo: int) -> int:
    """Return the side of a tile for a halo, both in pixels of the low resolution."""
    return max(TILE_PX, _HALOS * halo)


@dataclass(frozen=True, eq=False)
class Enlargement:
    """How a normal map is enlarged.

    Parameters
    ----------
    scale
        Factor of the resolution.
    model, network
        The network; None for bicubic interpolation.
    self_ensemble
        Whether the mean of turned copies is used.
    sampling
        What the normals of the map are.
    """

    scale: int
    model: SuperResolutionModel | None
    network: Network | None
    self_ensemble: bool
    sampling: PixelSampling

    @classmethod
    def by(
        cls,
        scale: int,
        method: SuperResolutionMethod | None,
        model: str | Path | SuperResolutionModel | None,
        self_ensemble: bool | None,
        sampling: PixelSampling,
    ) -> Enlargement:
        """Load the network; parameters and errors are those of `super_resolve`."""
        if scale not in SCALES:
            raise DataError(f"a scale of {scale} is not available: use 2 or 4")
        if method == "bicubic":
            if model is not None or self_ensemble:
                raise DataError("bicubic interpolation uses no network: leave out the network")
            return cls(scale, None, None, False, "area")
        if isinstance(model, SuperResolutionModel):
            model.check(scale, method)
            used = model
        else:
            used = read_superres_model(model, scale, method)
        turned = scale == _ENSEMBLE_SCALE if self_ensemble is None else self_ensemble
        return cls(scale, used, Network(used), turned, sampling)

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
        return tile_side(self.halo)

    def size(self, low: tuple[int, int], max_pixels: int) -> tuple[int, int]:
        """Return the size of the result, of a map of (height, width).

        Raises
        ------
        DataError
            If it has more pixels than are allowed.
        """
        height, width = (self.scale * length for length in low)
        if height * width > max_pixels:
            raise DataError(
                f"scale {self.scale} turns {low[1]} x {low[0]} pixels into {width} x {height}, "
                f"{max_pixels} are allowed: use a part of the map, or raise the limit on pixels"
            )
        return height, width

    def forms(self, size: tuple[int, int]) -> dict[str, tuple[tuple[int, ...], type[np.generic]]]:
        """Return shapes and types of the maps of a result.

        They are those of `SuperResolution`, and ``sums``: of each row, the sum of the squares of
        ``added_deg`` and of the detail of an interpolation, and of ``added_deg``.
        """
        plain = (size, np.float32)
        maps: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {
            "normals": ((*size, 3), np.float32),
            "mask": (size, np.bool_),
            "added_deg": plain,
            "invented": plain,
            "sums": ((size[0], _SUMS), np.float64),
        }
        return maps if self.model is None else maps | {"sigma_deg": plain}

    def bands(self, mask: Mask) -> list[Span]:
        """Return the rows of the low resolution that are computed together."""
        return spans(len(mask), self.side, self.halo)

    def tile_count(self, mask: Mask, bands: Iterable[Span]) -> int:
        """Return the number of tiles of some bands."""
        reach = reached(mask)
        return sum(
            1
            for band in bands
            for _ in tiles(reach[band.around], band.inside, self.side, self.halo)
        )

    def rows(
        self,
        normals: MapRows,
        mask: Mask,
        band: Span,
        wanted: Mask | None = None,
        on_tile: Callable[[], None] = lambda: None,
    ) -> Maps:
        """Return the maps of the result for a band.

        Parameters
        ----------
        normals, mask
            The complete map of the low resolution, in memory or on disk.
        band
            One of `bands`.
        wanted
            As the mask of `super_resolve`.
        on_tile
            Called after each tile.
        """
        scale = self.scale
        rows = enlarged_rows(band.core, scale)
        size = rows.stop - rows.start, scale * mask.shape[1]
        maps = {name: np.zeros(*form) for name, form in self.forms(size).items()}
        if "sigma_deg" in maps:
            maps["sigma_deg"][:] = np.nan
        if not reached(mask[band.around])[band.inside].any():
            return maps
        low = LowMap.of(normals, mask, band.around, scale, self.halo, self.sampling)
        own = np.zeros(size, np.float32)
        domain = "normals" if self.model is None else self.model.domain
        for tile in tiles(low.reach, band.inside, self.side, self.halo):
            columns = enlarged_rows(tile.core[1], scale)
            made = enlarge(
                low,
                tile,
                scale,
                None if wanted is None else wanted[rows, columns],
                self.network,
                domain,
                self.self_ensemble,
            )
            _put(maps, own, columns, made)
            on_tile()
        maps["sums"][:] = _sums(maps, own)
        return maps


def _put(maps: Maps, own: npt.NDArray[np.float32], columns: slice, made: HighTile) -> None:
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


def _sums(maps: Maps, own: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    mask, added = maps["mask"], maps["added_deg"]
    return np.stack([sums_of_rows(each, mask) for each in (added**2, own**2, added)], axis=1)


def invented_share(sums: npt.NDArray[np.float64]) -> float:
    """Return the share of the detail that a network added, from the sums of all rows."""
    added, own = sums[:, 0].sum(), sums[:, 1].sum()
    return float(added / (added + own)) if added else 0.0
