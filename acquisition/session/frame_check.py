"""Checks of frames: before they are written, and when they are read back."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from acquisition._errors import DataError
from acquisition.files.storage import read_file, sha256_of
from acquisition.pixels.frame_quality import FrameQuality
from acquisition.pixels.quality import measure_quality
from acquisition.session.manifest import CameraRecord
from acquisition.session.session_frame import Damage, SessionFrame
from rig.arrays import UInt16

# Means are stored with four decimals, clipped fractions as shares.
_MEAN_SLACK_DN: Final = 1e-3
_SHARE_SLACK: Final = 1e-9


def measure_frame(pixels: UInt16, camera: CameraRecord, folder: Path, file: str) -> FrameQuality:
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


def frame_damage(frame: SessionFrame, camera: CameraRecord) -> Damage | None:
    """Read a frame back and compare it with its journal line.

    Compared are the size and the hash of the file, the hash of the decoded pixels, and the figures
    that frames are judged by: clipped share, percentiles and mean.

    Parameters
    ----------
    frame
        The frame as recorded in the journal.
    camera
        Camera record of the session.

    Returns
    -------
    Damage or None
        The first difference; None if the frame is intact.
    """
    reason = _file_reason(frame) or _pixel_reason(frame, camera)
    return None if reason is None else Damage(frame, reason, frame.path)


def _file_reason(frame: SessionFrame) -> str | None:
    if frame.path.exists() and not frame.path.is_file():
        return "is not a regular file"
    try:
        size = frame.path.stat().st_size
        data = read_file(frame.path) if size == frame.bytes else b""
    except FileNotFoundError:
        return "is in the journal but not there"
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    if size != frame.bytes:
        return f"has {size} bytes, {frame.bytes} were recorded"
    if sha256_of(data) != frame.file_sha256:
        return "was changed since it was recorded"
    return None


def _pixel_reason(frame: SessionFrame, camera: CameraRecord) -> str | None:
    try:
        pixels = frame.read()
    except DataError as error:
        return str(error).removeprefix(f"{frame.path}: ").partition("; ")[0]
    line = frame.line
    quality = measure_quality(
        pixels, white_level_dn=camera.white_dn, black_level_dn=camera.black_level_dn
    )
    differs = (
        quality.percentiles_dn != line.percentiles_dn
        or abs(quality.clipped_fraction - line.clipped_fraction) > _SHARE_SLACK
        or (
            line.mean_dn is not None
            and quality.mean_dn is not None
            and abs(quality.mean_dn - line.mean_dn) > _MEAN_SLACK_DN
        )
    )
    return "has other grey values than its journal line states" if differs else None
