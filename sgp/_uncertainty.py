"""The figures of error bars and samples, and the line that shows them on the terminal."""

from __future__ import annotations

from typing import cast

import numpy as np

import acquisition
import processing
from sgp._stage_metrics import NormalsMetrics, SampleShares

# Kinds with a smaller share are not on the terminal.
_SHOWN = 0.005
# Bytes that are read at once.
_READ = 32_000_000


def add_uncertainty(metrics: NormalsMetrics, stage: processing.Reconstruction) -> None:
    """Add the medians of the standard deviations, and the shares of the kinds of samples."""
    metrics["normal_sigma_deg"] = _median(stage.maps["normal_sigma_deg"])
    metrics["normal_sigma_common_deg"] = _median(stage.maps["normal_sigma_common_deg"])
    metrics["noise_from"] = stage.noise
    metrics["neighbour_correlation"] = stage.neighbour_correlation
    totals = [_total(stage.maps[f"samples_{kind.name.lower()}"]) for kind in processing.SampleKind]
    shares = [count / sum(totals) for count in totals]
    metrics["samples"] = SampleShares(
        lit=shares[processing.SampleKind.LIT],
        attached=shares[processing.SampleKind.ATTACHED],
        cast=shares[processing.SampleKind.CAST],
        saturated=shares[processing.SampleKind.SATURATED],
        outlier=shares[processing.SampleKind.OUTLIER],
        missing=shares[processing.SampleKind.MISSING],
    )


def sigma_lines(metrics: NormalsMetrics) -> list[str]:
    """Return lines for the terminal, of at most 78 columns."""
    sigma, common = metrics["normal_sigma_deg"], metrics["normal_sigma_common_deg"]
    lines = []
    if sigma is not None and np.isfinite(sigma):
        of_lights = f", of which {common:.2g} deg by lights and height" if common else ""
        lines.append(f"standard deviation of normals {sigma:.2g} deg (median){of_lights}")
    named = {"attached": "attached shadow", "cast": "cast shadow"}
    parts = [
        f"{share:.0%} {named.get(kind, kind)}"
        for kind, share in cast("dict[str, float]", metrics["samples"]).items()
        if share >= _SHOWN
    ]
    return [*lines, f"samples: {', '.join(parts)}"]


def _total(values: acquisition.MapRows) -> int:
    return sum(int(values[rows].sum(dtype=np.int64)) for rows in _bands(values))


def _median(values: acquisition.MapRows) -> float:
    """Return the median of the finite values, of which one copy is in memory."""
    parts = (values[rows] for rows in _bands(values))
    finite = np.concatenate([part[np.isfinite(part)] for part in parts])
    return float(np.median(finite, overwrite_input=True)) if finite.size else float("nan")


def _bands(values: acquisition.MapRows) -> list[slice]:
    height, width = values.shape
    return acquisition.rows_in_bands(height, values.dtype.itemsize * width, _READ)
