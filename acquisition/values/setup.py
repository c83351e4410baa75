"""With what a recording was made: rig, camera and lens; and what lights were calibrated with."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from acquisition._errors import DataError
from acquisition.values.camera_model import CameraModel
from rig import short_repr


@dataclass(frozen=True, eq=False)
class Setup:
    """Rig, camera and lens of a recording, each of them if known.

    Parameters
    ----------
    rig
        Name of the rig in its rig file; empty if it is not known.
    camera_vendor, camera_model, camera_serial
        Identity that the camera reported; empty texts are not known.
    intrinsics
        Model of camera and lens for the complete upright image; None if it is not known.
    """

    rig: str = ""
    camera_vendor: str = ""
    camera_model: str = ""
    camera_serial: str = ""
    intrinsics: CameraModel | None = None

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class UsedSphere:
    """A mirror sphere from which lights were calibrated.

    Parameters
    ----------
    centre_px
        Column and row of the centre of its outline in the upright image.
    radius_px
        Geometric mean of the semi-axes of its outline.
    centre_mm, radius_mm
        Centre in the house frame, and radius; None if they are not known.
    recording
        Name of the recording that shows it; empty if all spheres are in one recording.
    """

    centre_px: tuple[float, float]
    radius_px: float
    centre_mm: tuple[float, float, float] | None = None
    radius_mm: float | None = None
    recording: str = ""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        lengths = [self.radius_px, *([] if self.radius_mm is None else [self.radius_mm])]
        values = [*self.centre_px, *(self.centre_mm or ()), *lengths]
        if not np.isfinite(values).all() or min(lengths) <= 0:
            raise DataError("a used sphere needs finite numbers and a positive radius")


@dataclass(frozen=True, eq=False)
class Calibrated:
    """When and with what lights were calibrated.

    Parameters
    ----------
    time_utc
        Start of the recording with the spheres; if the recording does not state it, the time of
        the computation. None if it is not known.
    setup
        Rig, camera and lens.
    spheres
        Spheres that were used.

    Raises
    ------
    DataError
        If the time has no time zone.
    """

    time_utc: datetime | None = None
    setup: Setup = field(default_factory=Setup)
    spheres: tuple[UsedSphere, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.time_utc is None:
            return
        if self.time_utc.utcoffset() is None:
            raise DataError("the time of a calibration needs a time zone: give it in UTC")
        object.__setattr__(self, "time_utc", self.time_utc.astimezone(UTC))
