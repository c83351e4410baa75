"""Errors of super-resolution on one map: normals, heights, and predicted deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

import acquisition
import processing

Domain = Literal["normals", "detail"]
Networks = dict[Domain, list[processing.SuperResolutionModel]]

DOMAINS: tuple[Domain, ...] = ("detail", "normals")
_PARTS = 10


@dataclass(frozen=True)
class Judgement:
    """Errors over all pixels of the mask.

    Parameters
    ----------
    bicubic_deg, own_deg
        Mean angular errors of bicubic interpolation, and of the network of the program.
    by_domain
        For each domain, the mean angular errors of the compared networks in degrees, without
        turned copies.
    heights
        Root mean square errors of the heights after integration in pixels, for ``bicubic``,
        ``own``, and the first compared network of each domain.
    ratios
        Actual over predicted deviation of the network of the program, for tenths of the pixels
        with increasing prediction.
    invented
        Share of the detail that this network added.
    pixels
        Number of pixels.
    """

    bicubic_deg: float
    own_deg: float
    by_domain: dict[Domain, list[float]]
    heights: dict[str, float]
    ratios: list[float]
    invented: float
    pixels: int

    @property
    def change(self) -> float:
        """By how much the network of the program changes the error, in percent."""
        return self._change(self.own_deg)

    def changes(self, domain: Domain) -> list[float]:
        """Return by how much each network of a domain changes the error, in percent."""
        return [self._change(error) for error in self.by_domain[domain]]

    def height_change(self, name: str) -> float:
        """Return by how much a network changes the error of the heights, in percent."""
        return _percent(self.heights[name], self.heights["bicubic"], 1e-6)

    def _change(self, error: float) -> float:
        return _percent(error, self.bicubic_deg, 1e-3)


def judge(
    truth: processing.NormalMap,
    own: processing.SuperResolutionModel,
    compared: Networks,
) -> Judgement:
    """Reduce a map, enlarge it again in all ways, and compare it with itself.

    Parameters
    ----------
    truth
        The map; columns and rows that do not fill a large pixel are left out.
    own
        The network of the program; it has the scale.
    compared
        Networks of each domain; may be empty.
    """
    scale = own.scale
    height, width = (length // scale * scale for length in truth.size)
    truth = processing.NormalMap(
        truth.normals[:height, :width].copy(), truth.mask[:height, :width].copy()
    )
    low = processing.superres.low_resolution(truth, scale)
    plain = processing.super_resolve(low, scale, method="bicubic", mask=truth.mask)
    made = processing.super_resolve(low, scale, model=own, mask=truth.mask)
    maps = {"bicubic": plain.normal_map, "own": made.normal_map}
    errors = {name: processing.angular_error(one, truth).mae_deg for name, one in maps.items()}
    by_domain: dict[Domain, list[float]] = {}
    for domain, models in compared.items():
        for model in models:
            other = processing.super_resolve(
                low, scale, model=model, self_ensemble=False, mask=truth.mask
            ).normal_map
            error = processing.angular_error(other, truth)
            by_domain.setdefault(domain, []).append(error.mae_deg)
            maps.setdefault(domain, other)
    ground = processing.integrate(truth, discontinuity=False)
    heights = {
        name: processing.height_profile(ground, processing.integrate(one, discontinuity=False)).rms
        for name, one in maps.items()
    }
    ratios = deviation_ratios(made, truth)
    return Judgement(
        errors["bicubic"],
        errors["own"],
        by_domain,
        heights,
        ratios,
        made.invented_share,
        int(truth.mask.sum()),
    )


def deviation_ratios(made: processing.SuperResolution, truth: processing.NormalMap) -> list[float]:
    """Return actual over predicted deviation for tenths of the pixels, the most certain first."""
    if made.sigma_deg is None:
        return []
    inside = made.normal_map.mask & truth.mask
    predicted = made.sigma_deg[inside].astype(np.float64)
    actual = acquisition.angle_deg(made.normal_map.normals[inside], truth.normals[inside])
    parts = np.array_split(np.argsort(predicted, kind="stable"), _PARTS)
    return [float(np.sqrt(np.mean(actual[p] ** 2) / np.mean(predicted[p] ** 2))) for p in parts]


def _percent(error: float, plain: float, least: float) -> float:
    # The error of bicubic interpolation of a plane is 0 but for rounding.
    return 100 * (error - plain) / max(plain, least)
