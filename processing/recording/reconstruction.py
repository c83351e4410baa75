"""Result of the reconstruction of a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from acquisition import Lights, MapRows, Source
from acquisition.files import BandStore, ComputedRows, MemoryMaps, rows_in_bands
from processing.checks.quality import ImageQuality
from processing.checks.verdict import Verdict
from processing.maps.metrics import AngularError
from processing.maps.normal_map import NormalMap
from processing.near.near_height import NearHeight
from processing.noise.inconsistency import POOLED, Inconsistency, mean_of
from processing.noise.interreflection import reflected_variance
from processing.noise.lens_blur import LensBlur
from processing.noise.normal_errors import (
    UNIFORM_DEG,
    NormalUncertainty,
    in_degrees,
    valid_reasons,
)
from processing.noise.pixel_variances import ALIKE, UNIFORM, Origin
from processing.noise.sample_kind import SampleKind
from processing.series.ambient_light import AmbientLight
from processing.series.light_distance import LightDistance
from processing.series.strengths import LightStrengths
from processing.surface.height_map import HeightMap
from rig import Notice
from rig.arrays import AnyArray, Bool, Float32, UInt16

# Bytes of rows that are finished at once.
_BAND = 32_000_000


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The normals and the height of a recorded object, with the data they were computed from.

    Parameters
    ----------
    source
        The recording.
    lights
        The lights of the images that were used, in their order.
    mask
        ``(H, W)`` bool, the object: the mask of the source, or one computed from the images.
    valid
        ``(H, W)`` bool, the pixels with a normal.
    maps
        The maps of a result by the names of their files, in memory or in files: ``normals``
        ``(H, W, 3)``, ``albedo`` ``(H, W, 3)`` linear RGB if the images have colour, else
        ``(H, W)``, ``residual``, ``specular``, ``used``, ``normal_sigma_deg``,
        ``normal_sigma_common_deg``, ``validity`` and ``samples_*``; and ``gray_albedo``.
    noise, neighbour_correlation
        As in `NormalUncertainty`.
    quality
        Agreement of images, lights and normals.
    verdict
        What is probably wrong with the recording, and whether the result can be used.
    excluded
        Names of the images that were left out because they disagree with the others.
    strengths
        Strengths of the lights, if they were estimated.
    error
        Error of the normals over `mask`; None if the source has no ground truth.
    previews
        The first and the last linear image, each ``(H, W)`` float32; in files, where the mask is.
    near_height
        Where the surface is, under near lights; None under distant lights.
    warnings
        Warnings about the source, the stack, the normals and the height.
    store
        Files of the maps, which `BandStore.remove` deletes; None if they are in memory.
    surface
        The height; None if it was not requested.
    light_distance
        Distance of the lights from the middle of the object, if they had only directions and it was
        stated or estimated; `source` and `lights` have their positions.
    ambient
        The constant light that was subtracted; None if it was not estimated.
    blur
        The blur of the lens that the normals show; None if the noise is unknown.
    rescaled
        Images that were divided by a factor because only their brightness is wrong, with the
        factor; `source` and `lights` have the intensities times it.
    """

    source: Source
    lights: Lights
    mask: Bool
    valid: Bool
    maps: Mapping[str, MapRows]
    noise: Origin
    neighbour_correlation: float
    quality: ImageQuality
    verdict: Verdict
    excluded: tuple[str, ...]
    strengths: LightStrengths | None
    error: AngularError | None
    previews: tuple[MapRows, ...]
    near_height: NearHeight | None
    warnings: tuple[Notice, ...]
    store: BandStore | None = None
    surface: HeightMap | None = None
    light_distance: LightDistance | None = None
    ambient: AmbientLight | None = None
    blur: LensBlur | None = None
    rescaled: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def normals(self) -> NormalMap:
        """Normals of the valid pixels."""
        return NormalMap.of_unit_vectors(self.maps["normals"][:], self.valid)

    @property
    def albedo(self) -> Float32:
        """``(H, W, 3)`` float32 linear RGB if the images have colour, else ``(H, W)``."""
        return self.maps["albedo"][:]

    @property
    def gray_albedo(self) -> Float32:
        """``(H, W)`` float32 gray albedo, see `photometric_stereo`."""
        return self.maps["gray_albedo"][:]

    @property
    def residual(self) -> Float32:
        """``(H, W)`` float32 residual of the gray images, see `photometric_stereo`."""
        return self.maps["residual"][:]

    @property
    def used(self) -> UInt16:
        """``(H, W)`` uint16, number of samples of each pixel."""
        return self.maps["used"][:]

    @property
    def specular(self) -> Float32:
        """``(H, W)`` float32 mean light above a matte surface, see `specular_residual`."""
        return self.maps["specular"][:]

    @cached_property
    def uncertainty(self) -> NormalUncertainty:
        """Standard deviations of the normals, what the samples show, why pixels are not valid."""
        samples = [self.maps[f"samples_{kind.name.lower()}"][:] for kind in SampleKind]
        return NormalUncertainty(
            self.maps["normal_sigma_deg"][:],
            self.maps["normal_sigma_common_deg"][:],
            np.stack(samples),
            self.maps["validity"][:],
            self.noise,
            self.neighbour_correlation,
        )

    def __repr__(self) -> str:
        height, width = self.mask.shape
        count = int(np.count_nonzero(self.valid))
        parts = [
            str(self.source.path),
            f"NormalMap(float32[{height}, {width}, 3], {count} normals)",
        ]
        if self.surface is not None:
            parts.append(f"height in {self.surface.unit}")
        if self.error is not None:
            parts.append(f"mean error {self.error.mae_deg:.2f} deg")
        return f"Reconstruction({', '.join(parts)})"


def finished_maps(
    store: MemoryMaps | BandStore,
    valid: Bool,
    common: np.float32,
    origin: Origin,
    blur: LensBlur | None,
) -> dict[str, MapRows]:
    """Return the maps of a result from what the solver wrote.

    Maps in memory are finished here, others whenever their rows are read.

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
    blur
        The blur of the lens; None if the noise is unknown.
    """

    def finished(name: str, finish: Callable[[AnyArray, slice], AnyArray]) -> MapRows:
        file = store[name]
        if isinstance(store, BandStore):
            return ComputedRows(file.shape, file.dtype, lambda rows: finish(file[rows], rows))
        row = file.dtype.itemsize * int(np.prod(file.shape[1:]))
        for rows in rows_in_bands(len(file), row, _BAND):
            file[rows] = finish(file[rows], rows)
        return file

    def where_valid(name: str) -> MapRows:
        def finish(values: AnyArray, rows: slice) -> AnyArray:
            inside = valid[rows]
            return np.where(inside[..., None] if values.ndim == 3 else inside, values, 0)

        return finished(name, finish)

    def deviations(name: str, besides: Callable[[slice], AnyArray | np.float32]) -> MapRows:
        def finish(values: AnyArray, rows: slice) -> AnyArray:
            variances = values + besides(rows)
            in_degrees(variances, valid_reasons(store["reason"][rows], origin))
            return variances

        return finished(name, finish)

    inconsistent = Inconsistency.of(store["normals"], valid)

    def beyond_noise(rows: slice) -> Float32:
        rest = store["sigma"][rows] - store["noise"][rows] - store["common_sigma"][rows]
        return np.asarray(np.clip(rest, 0, UNIFORM), np.float32)

    typical = mean_of(beyond_noise, valid) if common > 0 else np.float32(0)

    def of_model(rows: slice) -> AnyArray:
        own: Float32 = store["sigma"][rows]
        found = np.full_like(own, common)
        if common > 0:
            pooled = np.float32(POOLED) * (typical - beyond_noise(rows))
            found += pooled
            # The more of the variance is by the model, the more of it goes with inconsistency.
            by_model = beyond_noise(rows) + pooled + common
            factor = inconsistent.factor(store["normals"], valid, rows) - np.float32(1)
            found += by_model**2 / (own + pooled + common) * factor
        found += reflected_variance(store["samples"], valid, rows)
        if blur is not None:
            found += blur.variance(store["normals"], store["noise"], valid, rows)
        return found

    def counts(kind: SampleKind) -> ComputedRows:
        samples = store["samples"]
        return ComputedRows(valid.shape, samples.dtype, lambda rows: samples[rows][:, kind])

    gray = where_valid("albedo")
    maps: dict[str, MapRows] = {
        "normals": where_valid("normals"),
        "albedo": where_valid("colour") if "colour" in store else gray,
        "gray_albedo": gray,
        "residual": where_valid("residual"),
        "specular": where_valid("specular"),
        "used": store["used"],
        "normal_sigma_deg": deviations("sigma", of_model),
        "normal_sigma_common_deg": deviations(
            "common_sigma", lambda rows: np.float32(ALIKE) * common
        ),
        "validity": store["reason"],
    }
    return maps | {f"samples_{kind.name.lower()}": counts(kind) for kind in SampleKind}


def with_common_error(maps: Mapping[str, MapRows], common_deg: float) -> dict[str, MapRows]:
    """Return the maps of a result whose normals have another error in common, in degrees."""

    def more(name: str) -> MapRows:
        file, limit = maps[name], np.float32(UNIFORM_DEG)
        return ComputedRows(
            file.shape,
            file.dtype,
            lambda rows: np.minimum(np.hypot(file[rows], np.float32(common_deg)), limit),
        )

    if common_deg == 0:
        return dict(maps)
    changed = ("normal_sigma_deg", "normal_sigma_common_deg")
    return dict(maps) | {name: more(name) for name in changed}
