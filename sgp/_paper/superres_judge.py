"""Errors of super-resolution on one map: normals, heights, and predicted deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

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
    bicubic_deg
        Mean angular error of bicubic interpolation.
    by_domain
        For each domain, the mean angular errors of its networks in degrees.
    heights
        Root mean square errors of the heights after integration in pixels, for ``bicubic`` and the
        first network of each domain.
    ratios
        Actual over predicted deviation of the first network, for tenths of the pixels with
        increasing prediction; empty without a network.
    invented
        Share of the detail that this network added.
    """

    bicubic_deg: float
    by_domain: dict[Domain, list[float]]
    heights: dict[str, float]
    ratios: list[float]
    invented: float

    def changes(self, domain: Domain) -> list[float]:
        """Return by how much each network of a domain changes the error, in percent."""
        # The error of bicubic interpolation of a plane is 0 but for rounding.
        least = max(self.bicubic_deg, 1e-3)
        return [100 * (own - self.bicubic_deg) / least for own in self.by_domain[domain]]


def judge(truth: processing.NormalMap, scale: int, networks: Networks) -> Judgement:
    """Reduce a map, enlarge it again in all ways, and compare it with itself.

    Parameters
    ----------
    truth
        The map; columns and rows that do not fill a large pixel are left out.
    scale
        Factor of the resolution.
    networks
        The networks of each domain.
    """
    height, width = (length // scale * scale for length in truth.size)
    truth = processing.NormalMap(
        truth.normals[:height, :width].copy(), truth.mask[:height, :width].copy()
    )
    low = processing.low_resolution(truth, scale)
    plain = processing.super_resolve(low, scale, method="bicubic", mask=truth.mask).normal_map
    maps = {"bicubic": plain}
    by_domain: dict[Domain, list[float]] = {}
    ratios: list[float] = []
    invented = 0.0
    for domain, models in networks.items():
        for model in models:
            made = processing.super_resolve(low, scale, model=model, mask=truth.mask)
            error = processing.angular_error(made.normal_map, truth)
            by_domain.setdefault(domain, []).append(error.mae_deg)
            maps.setdefault(domain, made.normal_map)
            if not ratios:
                ratios, invented = deviation_ratios(made, truth), made.invented_share
    ground = processing.integrate(truth)
    heights = {
        name: processing.height_profile(ground, processing.integrate(one)).rms
        for name, one in maps.items()
    }
    error = processing.angular_error(plain, truth)
    return Judgement(error.mae_deg, by_domain, heights, ratios, invented)


def deviation_ratios(made: processing.SuperResolution, truth: processing.NormalMap) -> list[float]:
    """Return actual over predicted deviation for tenths of the pixels, the most certain first."""
    if made.sigma_deg is None:
        return []
    inside = made.normal_map.mask & truth.mask
    predicted = made.sigma_deg[inside].astype(np.float64)
    actual = processing.angle_deg(made.normal_map.normals[inside], truth.normals[inside])
    parts = np.array_split(np.argsort(predicted, kind="stable"), _PARTS)
    return [float(np.sqrt(np.mean(actual[p] ** 2) / np.mean(predicted[p] ** 2))) for p in parts]
