"""What a camera wrote about a shot into its image file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from acquisition._pixels.tiff_tags import Tags

# Exif 2.32, 4.6; of TIFF files the same numbers may be in the main directory.
MAKE, MODEL, ORIENTATION = 271, 272, 274
EXPOSURE_TIME, F_NUMBER, ISO_RATING, TAKEN = 33434, 33437, 34855, 36867
INDEX, ISO_SPEED, SHUTTER_SPEED, APERTURE = 34866, 34867, 37377, 37378
SHOT_TAGS: Final = (
    MAKE, MODEL, ORIENTATION, EXPOSURE_TIME, F_NUMBER, ISO_RATING, TAKEN, INDEX, ISO_SPEED,
    SHUTTER_SPEED, APERTURE,
)  # fmt: skip
# The rating has 16 bits; this value means that another tag has the sensitivity.
_ISO_ELSEWHERE: Final = 65535
# Two statements of one time differ by less than a sixth of a stop, by which markings are rounded.
_ONE_TIME: Final = 2 ** (1 / 6)


@dataclass(frozen=True)
class ShotFacts:
    """Metadata of one shot from an image file; None if the file does not state it.

    Parameters
    ----------
    exposure_us
        Exposure time, microseconds: Exif ExposureTime, which cameras round to a marking.
    shutter_us
        Exposure time by Exif ShutterSpeedValue, microseconds, which is finer; None also if it
        contradicts `exposure_us`.
    iso
        Sensitivity.
    f_number
        Aperture, as focal length over diameter.
    orientation
        How a viewer turns the stored pixels, 1 (not at all, also without a tag) to 8: TIFF 6.0,
        tag 274.
    taken
        Time of the shot by the camera's clock, which has no time zone; UTC is assumed.
    vendor, model
        Vendor and model of the camera; empty if not known.
    """

    exposure_us: float | None = None
    shutter_us: float | None = None
    iso: float | None = None
    f_number: float | None = None
    orientation: int | None = None
    taken: datetime | None = None
    vendor: str = ""
    model: str = ""

    @property
    def time_us(self) -> float | None:
        """The exposure time, by the finer statement if there are two."""
        return self.exposure_us if self.shutter_us is None else self.shutter_us


def shot_facts(tags: Tags) -> ShotFacts:
    """Return the facts of tags; values without a meaning count as not stated."""
    exposure_us = _microseconds(_positive(tags.get(EXPOSURE_TIME)))
    shutter_us = _microseconds(_power(tags.get(SHUTTER_SPEED), -1))
    if exposure_us and shutter_us:
        ratio = shutter_us / exposure_us
        shutter_us = shutter_us if 1 / _ONE_TIME < ratio < _ONE_TIME else None
    iso = _positive(tags.get(ISO_RATING))
    if iso in (None, _ISO_ELSEWHERE):
        iso = _positive(tags.get(ISO_SPEED)) or _positive(tags.get(INDEX)) or iso
    orientation = _positive(tags.get(ORIENTATION))
    return ShotFacts(
        exposure_us=exposure_us,
        shutter_us=shutter_us,
        iso=iso,
        f_number=_positive(tags.get(F_NUMBER)) or _power(tags.get(APERTURE), 0.5),
        orientation=int(orientation) if orientation and orientation < 9 else 1,
        taken=_time(tags.get(TAKEN)),
        vendor=str(tags.get(MAKE, "")),
        model=str(tags.get(MODEL, "")),
    )


def _positive(value: object) -> float | None:
    return value if isinstance(value, float) and 0 < value < math.inf else None


def _power(value: object, scale: float) -> float | None:
    """Return 2 to the power of an APEX value times a scale; None for markers of unknown values."""
    if not isinstance(value, float) or not abs(value) < 64:
        return None
    return float(2 ** (value * scale))


def _microseconds(seconds: float | None) -> float | None:
    return None if seconds is None else float(f"{seconds * 1e6:.7g}")


def _time(value: object) -> datetime | None:
    try:
        return datetime.strptime(str(value), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None
