"""Whether pixels are what a session says that its camera delivers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition._pixels.quality import FrameQuality, measure_quality
from acquisition._session.manifest import CameraRecord


def measure_frame(
    pixels: npt.NDArray[np.uint16], camera: CameraRecord, folder: Path, file: str
) -> FrameQuality:
    """Measure a frame and refuse one that is not as the camera's record states.

    Parameters
    ----------
    pixels
        ``(H, W)`` or ``(H, W, 3)`` uint16.
    camera
        Size, bits and levels of the session.
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
            f"this session holds uint16 of {camera.shape}"
        )
    quality = measure_quality(
        pixels, white_level_dn=camera.white_dn, black_level_dn=camera.black_level_dn
    )
    if quality.percentiles_dn["100"] >= 2**camera.bit_depth:
        raise DataError(
            f"{folder}: {file} has a value of {quality.percentiles_dn['100']}, more "
            f"than {camera.bit_depth} bits hold; set the camera to deliver low-aligned samples"
        )
    return quality
