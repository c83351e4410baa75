"""Frames of each light, and whether the images made from them can be used."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Frame, Source
from calibration._errors import EstimateError

FloatImage = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]
# What the images of a stack show: gray values, colours, or the colour of each site of a mosaic.
Channel = Literal["gray", "rgb", "mosaic"]
# The frames of a light and its intensity in each colour.
Task = tuple[list[Frame], Array]

_THREADS = 4
# Bytes of the linear images that are computed at the same time; each needs several times as much.
_AT_ONCE = 200_000_000
_LEAST_GREY_VALUES = 100.0


def lit_frames(source: Source) -> list[Frame]:
    """Return the frames with a light.

    Raises
    ------
    DataError
        If no frame has a light, or black and white level contradict each other.
    """
    lit = [frame for frame in source.frames if frame.role == "light"]
    if not lit:
        raise DataError(f"{source.path}: no image with a light")
    if not source.white_level > source.black_level >= 0:
        raise DataError(
            f"{source.path}: the white level of {source.white_level} must be above the black level "
            f"of {source.black_level}, which must not be negative"
        )
    return lit


def threads_for(image_bytes: int) -> int:
    """Return the number of threads for images whose linear values have this size."""
    return max(1, min(_THREADS, _AT_ONCE // image_bytes))


def frames_of_lights(source: Source, lit: list[Frame]) -> list[Task]:
    """Return the frames of each light and its intensity in each colour."""
    lights = source.lights
    return [
        (
            [frame for frame in lit if frame.light_id == name],
            np.ones(3) if lights is None or lights.intensities is None else lights.intensities[i],
        )
        for i, name in enumerate(source.light_ids)
    ]


def brightest_sample(image: FloatImage) -> np.float32:
    """Return the largest sample that is not NaN; NaN without any."""
    return np.float32(np.fmax.reduce(image, axis=None))


def check_usable(
    images: list[np.float32], ids: tuple[str, ...], source: Source, reference_level: float
) -> None:
    """Refuse images that show nothing.

    Parameters
    ----------
    images
        The brightest sample of each; NaN if all are saturated.
    ids
        Names of all images.
    source
        Their source.
    reference_level
        Largest signal of the references that were subtracted.

    Raises
    ------
    EstimateError
        If all samples are saturated or black.
    """
    # fmax skips images without any sample; max could return their NaN.
    brightest = np.fmax.reduce(images)
    if np.isnan(brightest):
        raise EstimateError(
            f"{source.path}: every sample of {_all(len(ids))} is saturated: "
            "record with a shorter exposure time"
        )
    # Rounding and an inaccurate black level leave up to two grey values in a dark image.
    span = source.white_level - source.black_level
    least = float(source.transfer.light(2 / span)) if span >= _LEAST_GREY_VALUES else 0.0
    if not brightest > least and reference_level > least:
        raise EstimateError(
            f"{source.path}: the dark or ambient frames are as bright as {_all(len(ids))}: check "
            "which frames are dark, and that the LEDs were off"
        )
    if not brightest > least:
        raise EstimateError(
            f"{source.path}: {_all(len(ids))} {'is' if len(ids) == 1 else 'are'} black or "
            "saturated: check the lights and the exposure"
        )


def _all(images: int) -> str:
    return "the image" if images == 1 else f"all {images} images"
