"""Flat fields from matte cards under near lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import cv2
import numpy as np

from acquisition import DataError, Flat, Lights, Source
from acquisition.source import source_setup
from acquisition.values import Calibrated
from calibration.flat.card import CardField, measure_card
from calibration.flat.pixel_part import combine
from calibration.flat.sites import Sites
from calibration.flat.smooth_part import smooth_part
from calibration.spheres.spheres_beside_object import check_recordings
from rig import Notice, Progress, check_type, no_progress, pluralize
from rig.arrays import Bool, Float32

# A card that leaves less than this open is as large as the image.
_WHOLE = 0.999
# Weights of smooth parts fade over this part of the image beyond the card.
_FADE, _LEAST_WEIGHT = 8, 1e-3
# Smooth parts are compared at about this many places in each direction.
_SAMPLES = 256


@dataclass(frozen=True, eq=False)
class FlatCalibration:
    """A flat field and its quality.

    Parameters
    ----------
    flat
        The flat.
    prnu
        Standard deviation among the pixels of the pixel part, without that of its noise. With one
        recording, the texture of the card is in it.
    card_std
        Standard deviation of the texture of the card that is left in the flat; None if one
        recording does not show it.
    uneven
        Rms difference between the smooth parts of the recordings, without a gradient; None with one
        recording. The unevenness of the card is of this size.
    stains
        Number of pixels at which the recordings contradict each other.
    residual
        Robust relative deviation of the card from the model of its lights; 0.01 is 1 %. Pixels are
        averaged over blocks.
    frames
        Number of frames of lit cards that were used.
    lights
        The lights as they were fitted to the first card.
    warnings
        What the flat contains besides lens and sensor, and doubts about the recordings.
    """

    flat: Flat
    prnu: float
    card_std: float | None
    uneven: float | None
    stains: int
    residual: float
    frames: int
    lights: Lights
    warnings: tuple[Notice, ...]

    def __repr__(self) -> str:
        return f"FlatCalibration({self.flat!r}, PRNU {self.prnu:.2%})"


def calibrate_flat(
    sources: Source | Sequence[Source],
    lights: Lights,
    *,
    z_mm: float = 0.0,
    mask: Bool | None = None,
    on_progress: Progress = no_progress,
) -> FlatCalibration:
    """Estimate vignetting and the response of the pixels from a matte white card under near lights.

    The card is divided by the light of its LEDs, ``intensity * n.l / r^2 * (cos t / cos t0)^mu``
    (Queau et al., 2018). Intensities, axes and `mu` are fitted to the card itself, see
    `calibrate_intensities`; the positions are those of the lights. Images are averaged with weights
    that are inversely proportional to their variances (`Stack.noise`). The logarithm of the result
    is split into a polynomial of the image and the rest. A linear gradient of the flat and a common
    tilt of all lights look alike; `Flat.gradient_std` is its standard deviation.

    Parameters
    ----------
    sources
        Recordings of a card in the working plane that fills the image, with one image for each
        light and dark frames. Of several recordings, the card was moved or turned between them, by
        more than its grain and stains; texture of the card is then averaged.
    lights
        Near lights; those of the images are found by name or order.
    z_mm
        Height of the card's upper side over the working plane.
    mask
        ``(H, W)`` pixels that show the card; default: they are found.
    on_progress
        Receives the stage ``reading``, one step per light.

    Returns
    -------
    FlatCalibration
        The flat and its quality. Pixels that do not show the card have an extrapolated smooth part.

    Raises
    ------
    DataError
        If the lights are distant, the camera is not known, the recordings differ in camera or size,
        or a recording cannot be read.
    EstimateError
        If the card covers less than half of the image, is saturated, shaded or glossy; the message
        names the recording, the light and the pixel.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import CameraModel, Lights, read_source, write_png
    >>> from calibration import calibrate_flat
    >>> camera = CameraModel(np.array([[90, 0, 31.5], [0, 90, 23.5], [0, 0, 1]]), 64, 48, 500)
    >>> lamps = Lights(positions_mm=[[200, 0, 300], [0, 250, 300], [-200, 0, 300], [0, -250, 300]])
    >>> card = 30000 * lamps.vectors_at(camera.points_on_plane())[..., 2]
    >>> for i in range(4):
    ...     write_png(f"L0{i}.png", np.rint(card[i]).astype(np.uint16))
    >>> calibrate_flat(read_source(".", camera=camera), lamps).flat
    Flat(64 x 48 px, corners 100.0%)
    """
    check_type("lights", lights, Lights, "Lights(positions_mm=positions)")
    recordings = [sources] if isinstance(sources, Source) else list(sources)
    if not recordings:
        raise DataError("no recording: give at least one of a card")
    for source in recordings:
        check_type("sources", source, Source, "acquisition.read_source(path) returns one")
    check_recordings(recordings)
    first = recordings[0]
    sites = Sites(first.frames[0].shape, first.cfa)
    if mask is not None and mask.shape != sites.shape[:2]:
        raise DataError(f"a mask of the shape {mask.shape} for images of {sites.shape[:2]}")
    fields = [measure_card(source, lights, z_mm, mask, on_progress) for source in recordings]
    logarithms = [smooth_part(one.response, one.measured, sites) for one in fields]
    for one, log in zip(fields, logarithms, strict=True):
        np.divide(one.response, np.exp(log), out=one.response)
    pixel = combine(
        [one.response for one in fields],
        [one.variance for one in fields],
        [one.measured for one in fields],
        sites,
    )
    smooth = np.exp(_mean(logarithms, [one.measured for one in fields]))
    covered = float(np.logical_or.reduce([one.measured for one in fields]).mean())
    flat = Flat(
        smooth,
        pixel.values,
        first.cfa,
        pixel.std,
        _gradient_std(fields),
        covered,
        Calibrated(first.recorded_utc or datetime.now(UTC), source_setup(first)),
    )
    frames = sum(frame.role == "light" for source in recordings for frame in source.frames)
    return FlatCalibration(
        flat,
        pixel.prnu,
        pixel.card_std,
        _uneven(logarithms) if len(fields) > 1 else None,
        pixel.stains,
        float(np.median([one.residual for one in fields])),
        frames,
        fields[0].lights,
        (
            *[notice for one in fields for notice in one.warnings],
            *_notices(len(fields), covered, pixel.dead),
        ),
    )


def _gradient_std(fields: Sequence[CardField]) -> float | None:
    """Return the mean: the errors of the lights are those of all recordings."""
    known = [one.gradient_std for one in fields if one.gradient_std is not None]
    return float(np.mean(known)) if known else None


def _mean(logarithms: Sequence[Float32], measured: Sequence[Bool]) -> Float32:
    """Return the mean of smooth parts; where one recording shows no card, the others count."""
    if all(one.mean() >= _WHOLE for one in measured):
        return np.asarray(np.mean(logarithms, axis=0), np.float32)
    total, weights = np.zeros_like(logarithms[0]), np.zeros_like(logarithms[0])
    side = max(total.shape[:2]) // _FADE
    for log, one in zip(logarithms, measured, strict=True):
        # The weight fades over some distance: a step would be in the flat.
        weight = cv2.blur(one.astype(np.float32), (side, side)) + np.float32(_LEAST_WEIGHT)
        total += weight * log
        weights += weight
    return total / weights


def _uneven(logarithms: Sequence[Float32]) -> float:
    """Return the rms difference between smooth parts, without their mean and gradient."""
    step = max(1, max(logarithms[0].shape) // _SAMPLES)
    parts = np.stack([log[::step, ::step] for log in logarithms]).astype(np.float64)
    rows, columns = np.indices(parts.shape[1:3]) / max(parts.shape[1:3])
    design = np.stack([np.ones_like(rows), rows, columns], axis=-1).reshape(-1, 3)
    rest = []
    for part in parts - parts.mean(axis=0):
        plane = part.reshape(len(design), -1)
        fitted = design @ np.linalg.lstsq(design, plane, rcond=None)[0]
        rest.append(float(np.mean((plane - fitted) ** 2)))
    return float(np.sqrt(np.sum(rest) / max(len(rest) - 1, 1)))


def _notices(recordings: int, covered: float, dead: int) -> list[Notice]:
    found = []
    if recordings == 1:
        text = (
            "the texture of the card is in the pixel part: record it again, moved or turned, and "
            "give both recordings"
        )
        found.append(Notice("flat-includes-card", text, severity="info"))
    if covered < _WHOLE:
        text = (
            f"the card covers {covered:.1%} of the image: beyond it, the smooth part is "
            "extrapolated and the pixel part is 1"
        )
        found.append(Notice("flat-extrapolated", text))
    if dead:
        text = f"{pluralize(dead, 'pixel')} without response: the pixel part is 1 there"
        found.append(Notice("flat-dead-pixels", text, severity="info"))
    return found
