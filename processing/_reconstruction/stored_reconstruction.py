"""What `reconstruct_on_disk` returns: a reconstruction whose maps are not in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from acquisition import BandStore, ComputedRows, Lights, MapRows, Source
from processing._metrics import AngularError
from processing._reconstruction.near_height import NearHeight
from processing._reconstruction.quality import ImageQuality
from processing._uncertainty.normal_uncertainty import in_degrees, valid_reasons
from processing._uncertainty.pixel_variances import Origin
from processing._uncertainty.sample_kind import SampleKind
from rig import Notice

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class StoredReconstruction:
    """Normals of a recording that is larger than memory, with the data they were computed from.

    Parameters
    ----------
    source, lights, mask, quality, excluded, error, near_height, warnings
        As in `Reconstruction`.
    valid
        ``(H, W)`` bool, the pixels with a normal.
    maps
        Maps whose rows are read on request: ``normals`` ``(H, W, 3)``, ``albedo`` ``(H, W)`` or
        ``(H, W, 3)``, ``residual``, ``specular``, ``used``, ``normal_sigma_deg``,
        ``normal_sigma_common_deg``, ``validity`` and ``samples_*``; see `Reconstruction.maps`.
    previews
        The first and the last linear image, each ``(H, W)`` float32, in the rows of the mask.
    noise, neighbour_correlation
        As in `NormalUncertainty`.
    store
        The files of the maps, which `BandStore.remove` deletes.
    """

    source: Source
    lights: Lights
    mask: Mask
    valid: Mask
    maps: Mapping[str, MapRows]
    noise: Origin
    neighbour_correlation: float
    quality: ImageQuality
    excluded: tuple[str, ...]
    error: AngularError | None
    previews: tuple[MapRows, MapRows]
    near_height: NearHeight | None
    warnings: tuple[Notice, ...]
    store: BandStore

    @property
    def strengths(self) -> None:
        """Strengths of lights are not estimated from maps on disk."""

    def __repr__(self) -> str:
        height, width = self.mask.shape
        return f"StoredReconstruction({self.source.path}, {width} x {height} px)"


def finished_maps(
    store: Mapping[str, MapRows], valid: Mask, common: np.float32, origin: Origin
) -> dict[str, MapRows]:
    """Return the maps of a result from what the solver wrote.

    Parameters
    ----------
    store
        Maps of `map_forms`, and ``colour`` if the images have colour.
    valid
        ``(H, W)`` bool, the pixels that have a normal.
    common
        Variance that all pixels have besides their own.
    origin
        Where the law of the noise is from.
    """

    def computed(name: str, function: Callable[[slice], npt.NDArray[Any]]) -> ComputedRows:
        file = store[name]
        return ComputedRows(file.shape, file.dtype, function)

    def where_valid(name: str) -> ComputedRows:
        def rows_of(rows: slice) -> npt.NDArray[Any]:
            values = store[name][rows]
            values[~valid[rows]] = 0
            return values

        return computed(name, rows_of)

    def deviations(name: str, besides: np.float32) -> ComputedRows:
        def rows_of(rows: slice) -> npt.NDArray[Any]:
            variances = store[name][rows]
            variances += besides
            in_degrees(variances, valid_reasons(store["reason"][rows], origin))
            return variances

        return computed(name, rows_of)

    def counts(kind: SampleKind) -> ComputedRows:
        samples = store["samples"]
        return ComputedRows(valid.shape, samples.dtype, lambda rows: samples[rows][:, kind])

    maps: dict[str, MapRows] = {
        "normals": where_valid("normals"),
        "albedo": where_valid("colour" if "colour" in store else "albedo"),
        "residual": where_valid("residual"),
        "specular": where_valid("specular"),
        "used": store["used"],
        "normal_sigma_deg": deviations("sigma", common),
        "normal_sigma_common_deg": deviations("common_sigma", np.float32(0)),
        "validity": store["reason"],
    }
    return maps | {f"samples_{kind.name.lower()}": counts(kind) for kind in SampleKind}
