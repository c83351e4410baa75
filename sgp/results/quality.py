"""The figures of quality, error bars and samples, and the lines that show them on the terminal."""

from __future__ import annotations

import math
from typing import cast

import numpy as np

import acquisition
import processing
from rig import figure
from rig.arrays import Float64
from sgp.results.stage_metrics import NormalsMetrics, QualityMetrics, SampleShares


def add_quality(metrics: QualityMetrics, quality: processing.checks.ImageQuality) -> None:
    """Add the figures to those of a command; those of single images only if they are known."""
    metrics["residual_relative"] = quality.residual
    metrics["consistency"] = quality.consistency
    metrics["samples_used"] = quality.used
    metrics["curl"] = quality.curl
    if np.isfinite(quality.image_residual).all():
        metrics["image_residuals"] = _listed(quality.image_residual)
    if np.isfinite(quality.light_error_deg).all():
        metrics["light_errors_deg"] = _listed(quality.light_error_deg)
        metrics["light_gains"] = _listed(quality.light_gain)


def quality_lines(quality: processing.checks.ImageQuality) -> list[str]:
    """Return the block for the terminal, of at most 78 columns."""
    lines = []
    if np.isfinite(quality.residual):
        lines.append(
            f"residual {quality.residual:.1%} of the signal, {quality.used:.0%} of the samples used"
        )
    errors, gains = quality.light_error_deg, quality.light_gain
    if np.isfinite(errors).all() and len(errors):
        worst = int(np.argmax(errors))
        lines.append(
            f"lights differ from the images by {np.median(errors):.1f} deg, "
            f"{_short(quality.ids[worst])} most, {errors[worst]:.1f} deg"
        )
        lines.append(f"brightness of the images {gains.min():.2f} to {gains.max():.2f} of expected")
    elif len(errors):
        lines.append("lights not compared: too few images, or the object is too flat")
    if np.isfinite(quality.curl):
        lines.append(f"curl {quality.curl:.2f} (0 for a surface, 0.7 for noise, 1 if mirrored)")
    return lines


def _listed(values: Float64) -> list[float]:
    return [round(float(value), 6) for value in values]


def _short(name: str) -> str:
    return name if len(name) <= 20 else f"{name[:17]}..."


# Kinds with a smaller share are not on the terminal.
_SHOWN = 0.005
# Bytes that are read at once.
_READ = 32_000_000


def add_uncertainty(metrics: NormalsMetrics, stage: processing.Reconstruction) -> None:
    """Add the medians of the standard deviations, and the shares of the kinds of samples."""
    metrics["normal_sigma_deg"] = median_of(stage.maps["normal_sigma_deg"])
    if stage.blur is not None and stage.blur.shown:
        metrics["lens_blur_px"] = stage.blur.sigma_px
    metrics["normal_sigma_common_deg"] = median_of(stage.maps["normal_sigma_common_deg"])
    metrics["noise_from"] = stage.noise
    metrics["neighbour_correlation"] = stage.neighbour_correlation
    totals = {name: _total(stage.maps[f"samples_{name}"]) for name in SampleShares.__annotations__}
    shares = {name: count / sum(totals.values()) for name, count in totals.items()}
    metrics["samples"] = cast("SampleShares", shares)


def sigma_lines(metrics: NormalsMetrics) -> list[str]:
    """Return lines for the terminal, of at most 78 columns."""
    sigma, common = metrics["normal_sigma_deg"], metrics["normal_sigma_common_deg"]
    lines = []
    if sigma is not None and np.isfinite(sigma):
        of_lights = f", of which {figure(common)} deg by lights and height" if common else ""
        lines.append(f"standard deviation of normals {figure(sigma)} deg (median){of_lights}")
    named = {"attached": "attached shadow", "cast": "cast shadow"}
    parts = [
        f"{share:.0%} {named.get(kind, kind)}"
        for kind, share in cast("dict[str, float]", metrics["samples"]).items()
        if share >= _SHOWN
    ]
    return [*lines, f"samples: {', '.join(parts)}"]


def _total(values: acquisition.MapRows) -> int:
    return sum(int(values[rows].sum(dtype=np.int64)) for rows in _bands(values))


def median_of(values: acquisition.MapRows) -> float:
    """Return the median of the finite values, of which one copy is in memory."""
    parts = (values[rows] for rows in _bands(values))
    finite = np.concatenate([part[np.isfinite(part)] for part in parts])
    return float(np.median(finite, overwrite_input=True)) if finite.size else float("nan")


def _bands(values: acquisition.MapRows) -> list[slice]:
    height, width = values.shape
    return acquisition.files.rows_in_bands(height, values.dtype.itemsize * width, _READ)


def rounded(value: float, sigma: float | None) -> tuple[str, str]:
    """Return a value and its expanded uncertainty (k = 2), to two digits of the latter.

    Without a finite standard uncertainty ``sigma``, the second text is empty.
    """
    expanded = 2 * sigma if sigma is not None else math.nan
    if not math.isfinite(expanded):
        return f"{value:.4g}", ""
    digits = 4 if expanded == 0 else max(0, 1 - math.floor(math.log10(expanded)))
    return f"{value:.{digits}f}", f"{expanded:.{digits}f}"
