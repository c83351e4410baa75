"""Check that the pixels of a frame agree with the camera record of the session."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition._pixels.frame_quality import FrameQuality
from acquisition._pixels.quality import measure_quality
from acquisition._session.manifest import CameraRecord


def measure_frame(
    pixels: npt.NDArray[np.uint16], camera: CameraRecord, folder: Path, file: str
) -> FrameQuality:
    """Measure a frame; refuse it if it does not agree with the camera record.

    Parameters
    ----------
    pixels
        ``(H, W)`` or ``(H, W, 3)`` uint16.
    camera
        Camera record of the session: size, bits and levels.
    folder, file
        The session and the frame's file, for the message.

    Raises
    ------
    DataError
        If shape or type differ, or a sample has more bits than the camera.
    """
    if pixels.dtype != np.uint16 or pixels.shape != camera.shape:
        raise DataError(
            f"{folder}: {file} has {pixels.dtype} pixels of shape {pixels.shape}; "
            f"this session requires uint16 of {camera.shape}"
        )
    quality = measure_quality(
        pixels, white_level_dn=camera.white_dn, black_level_dn=camera.black_level_dn
    )
    if quality.percentiles_dn["100"] >= 2**camera.bit_depth:
        raise DataError(
            f"{folder}: {file} has a value of {quality.percentiles_dn['100']}, which exceeds "
            f"{camera.bit_depth} bits; set the camera to deliver low-aligned samples"
        )
    return quality
