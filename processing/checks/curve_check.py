"""Comparison of the transfer curve of a source with its images under known lights."""

from __future__ import annotations

import numpy as np

from acquisition import LINEAR, SRGB, Lights, Source, TransferCurve
from processing.checks.strength_fit import light_vectors
from rig import Notice
from rig.arrays import Bool, Float32, Float64

_PIXELS = 3000
_FEWEST_PIXELS = 200
# A pixel has three unknowns; with fewer samples than this its residual says little.
_FEWEST_SAMPLES = 6
# Darker samples, relative to the brightest of their pixel, are probably in shadow.
_DARK = 0.1
# The alternative must fit better by this factor. Real captures and simulated scenes whose curve is
# correct reach 1.03 at the least, those whose curve is wrong .1 to .95.
_BETTER = 0.9
# The alternative must also fit well: with wrong lights nothing does, .07 to .34. Correct curves
# reach .01 to .05 in captures that follow sRGB.
_FITS = 0.06
_STEP = 1e-4


def curve_warnings(
    source: Source,
    values: Float32,
    lights: Lights,
    mask: Bool,
    points_mm: Float64 | None,
) -> list[Notice]:
    """Return a warning if the images fit the lights much better under another transfer curve.

    The alternative to linear is sRGB, and to all others linear. The light of a matte pixel that no
    light shadows is linear in the light vectors; the fit of three unknowns to more samples leaves
    a residual. Both residuals are expressed in stored samples, so that noise and gloss count
    equally: in units of light, a curve that flattens the samples would always seem to fit better.

    Parameters
    ----------
    source
        The recording.
    values
        ``(N, H, W)`` linear radiance under lights of intensity 1.
    lights
        The N lights.
    mask
        ``(H, W)`` bool, the object.
    points_mm
        ``(H, W, 3)`` surface points for lights with positions, else None.
    """
    if not np.isfinite(source.white_level) or len(values) < _FEWEST_SAMPLES:
        return []
    pixels = np.flatnonzero(mask)
    pixels = pixels[:: -(-len(pixels) // _PIXELS)]
    strength = _strength(source, lights)
    light = values.reshape(len(values), -1)[:, pixels].T * strength
    vectors = light_vectors(lights, points_mm, pixels) * strength[:, None]
    other = SRGB if source.transfer == LINEAR else LINEAR
    residuals = _residuals(light, vectors, source.transfer, other)
    if residuals is None:
        return []
    assumed, alternative = residuals
    # What both curves explain to the rounding of samples does not show the curve.
    if assumed < _STEP or alternative > _FITS or alternative > _BETTER * assumed:
        return []
    text = (
        f"read as {source.transfer.name} ({source.transfer_origin}), the images deviate from the "
        f"lights by {assumed:.1%}, but as {other.name} only by {alternative:.1%}: check the "
        "transfer curve"
    )
    return [Notice("transfer-curve-doubtful", text, str(source.path))]


def _strength(source: Source, lights: Lights) -> Float64:
    """Return the factors by which `linear_stack` divided the signal of each image."""
    exposures = {
        name: max(
            frame.exposure_us or 0.0
            for frame in source.frames
            if frame.role == "light" and frame.light_id == name
        )
        for name in source.light_ids
    }
    longest = max(exposures.values()) or 1.0
    relative = np.array([(exposures[name] or longest) / longest for name in lights.ids])
    return np.asarray(relative * np.asarray(lights.intensities, np.float64).mean(axis=1))


def _residuals(
    light: Float64, vectors: Float64, assumed: TransferCurve, other: TransferCurve
) -> tuple[float, float] | None:
    """Return the medians of the relative residuals under two curves; None without enough pixels."""
    measured = np.isfinite(light) & (light > 0) & (light < 1) & (vectors != 0).any(axis=2)
    samples = assumed.samples(np.where(measured, light, 0.0))
    # The same samples for both: those that are bright enough under the curve with more contrast.
    darker = np.minimum(light, other.light(samples))
    darker[~measured] = 0
    usable = darker > _DARK * darker.max(axis=1, keepdims=True)
    enough = usable.sum(axis=1) >= _FEWEST_SAMPLES
    if len(vectors) > 1:
        vectors = vectors[enough]
    samples, usable = samples[enough], usable[enough]
    if len(samples) < _FEWEST_PIXELS:
        return None
    mine = _relative(samples, assumed, vectors, usable)
    others = _relative(samples, other, vectors, usable)
    return float(np.median(mine)), float(np.median(others))


def _relative(samples: Float64, curve: TransferCurve, vectors: Float64, usable: Bool) -> Float64:
    """Return the rms residual of each pixel in samples, relative to the rms of its samples."""
    above, below = samples + _STEP, np.maximum(samples - _STEP, 0)
    slope = (curve.light(above) - curve.light(below)) / (above - below)
    weight = np.where(usable, 1 / slope, 0.0)
    rows = weight[..., None] * vectors
    target = weight * curve.light(samples)
    normal = rows.transpose(0, 2, 1) @ rows
    # Pixels whose lights do not determine them get a solution, and count for both curves alike.
    ridge = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    solved = np.linalg.solve(normal + ridge, rows.transpose(0, 2, 1) @ target[..., None])
    residual = target - (rows @ solved)[..., 0]
    count = usable.sum(axis=1)
    signal = np.sum(np.where(usable, samples, 0) ** 2, axis=1) / count
    return np.asarray(np.sqrt(np.sum(residual**2, axis=1) / (count - 3) / signal))
