"""The figures of error bars and samples, and the line that shows them on the terminal."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import processing
from sgp._metrics import NormalsMetrics, SampleShares

Mask = npt.NDArray[np.bool_]

# Kinds with a smaller share are not on the terminal.
_SHOWN = 0.005


def add_uncertainty(
    metrics: NormalsMetrics, found: processing.NormalUncertainty, mask: Mask
) -> None:
    """Add the medians of the standard deviations, and the shares of the kinds of samples."""
    metrics["normal_sigma_deg"] = _median(found.sigma_deg)
    metrics["normal_sigma_common_deg"] = _median(found.common_sigma_deg)
    metrics["noise_from"] = found.noise
    metrics["neighbour_correlation"] = found.neighbour_correlation
    shares = _shares(found, mask)
    metrics["samples"] = SampleShares(
        lit=shares["lit"],
        attached=shares["attached"],
        cast=shares["cast"],
        saturated=shares["saturated"],
        outlier=shares["outlier"],
        missing=shares["missing"],
    )


def sigma_lines(found: processing.NormalUncertainty, mask: Mask) -> list[str]:
    """Return lines for the terminal, of at most 78 columns."""
    sigma, common = _median(found.sigma_deg), _median(found.common_sigma_deg)
    lines = []
    if np.isfinite(sigma):
        of_lights = f", of which {common:.2g} deg by lights and height" if common > 0 else ""
        lines.append(f"standard deviation of normals {sigma:.2g} deg (median){of_lights}")
    named = {"attached": "attached shadow", "cast": "cast shadow"}
    parts = [
        f"{share:.0%} {named.get(kind, kind)}"
        for kind, share in _shares(found, mask).items()
        if share >= _SHOWN
    ]
    return [*lines, f"samples: {', '.join(parts)}"]


def _shares(found: processing.NormalUncertainty, mask: Mask) -> dict[str, float]:
    totals = found.samples[:, mask].sum(axis=1, dtype=np.int64)
    return {kind.name.lower(): float(totals[kind] / totals.sum()) for kind in processing.SampleKind}


def _median(values: npt.NDArray[np.float32]) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")
