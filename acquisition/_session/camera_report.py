"""What a camera reported with a frame."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CameraReport:
    """What a camera reported with a frame; None if unknown.

    Parameters
    ----------
    exposure_us
        Exposure time, microseconds; if None, the planned one is recorded.
    gain_db
        Gain, dB.
    frame_id
        Number that the camera gave the frame.
    timestamp_ns
        Time of the frame on the camera's clock, nanoseconds.
    temperature_c
        Temperature of the camera, degrees Celsius.
    """

    exposure_us: float | None = None
    gain_db: float | None = None
    frame_id: int | None = None
    timestamp_ns: int | None = None
    temperature_c: float | None = None
