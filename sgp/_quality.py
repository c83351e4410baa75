"""The figures of quality, and the lines that show them on the terminal."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import processing
from sgp._stage_metrics import QualityMetrics


def add_quality(metrics: QualityMetrics, quality: processing.ImageQuality) -> None:
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


def quality_lines(quality: processing.ImageQuality) -> list[str]:
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
        lines.append(f"curl {quality.curl:.2f} (surface 0, noise .7, mirrored 1)")
    return lines


def _listed(values: npt.NDArray[np.float64]) -> list[float]:
    return [round(float(value), 6) for value in values]


def _short(name: str) -> str:
    return name if len(name) <= 20 else f"{name[:17]}..."
