"""What an image file states about itself, read without decoding its pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from acquisition._errors import DataError, convert_read_errors
from acquisition.pixels.camera_raw import read_raw_header
from acquisition.pixels.exif_block import Tags, exif_tags, number_of, xmp_tags
from acquisition.pixels.image_input import opened_image, spec_attribute
from acquisition.pixels.metadata_curve import StatedCurve, stated_curve
from acquisition.pixels.stated_lens import (
    HEIGHT,
    LENS_TAGS,
    TAKEN,
    WIDTH,
    StatedLens,
    stated_lens,
)
from acquisition.values.image_names import is_raw
from acquisition.values.transfer_curve import LINEAR
from rig import MAX_PIXELS

# Exif 2.32, 4.6; of TIFF files the same numbers may be in the main directory.
MAKE, MODEL, ORIENTATION = 271, 272, 274
EXPOSURE_TIME, F_NUMBER, ISO_RATING = 33434, 33437, 34855
INDEX, ISO_SPEED, SHUTTER_SPEED, APERTURE = 34866, 34867, 37377, 37378
SHOT_TAGS: Final = (
    MAKE, MODEL, ORIENTATION, EXPOSURE_TIME, F_NUMBER, ISO_RATING, INDEX, ISO_SPEED,
    SHUTTER_SPEED, APERTURE, *LENS_TAGS,
)  # fmt: skip
# The rating has 16 bits; this value means that another tag has the sensitivity.
_ISO_ELSEWHERE: Final = 65535
# Two statements of one time differ by less than a sixth of a stop, by which markings are rounded.
_ONE_TIME: Final = 2 ** (1 / 6)
# Attributes of formats without Exif, by OpenImageIO's names. The samples of Radiance files were
# multiplied by their EXPOSURE, as by a time.
_ATTRIBUTES: dict[str, dict[int, tuple[str, ...]]] = {
    "openexr": {
        EXPOSURE_TIME: ("ExposureTime", "Exif:ExposureTime"),
        F_NUMBER: ("FNumber", "Exif:FNumber"),
        ISO_RATING: ("isoSpeed", "Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings"),
        ORIENTATION: ("Orientation",),
    },
    "hdr": {EXPOSURE_TIME: ("hdr:exposure",)},
}
# Statements of one aperture or sensitivity differ by less; steps of a third of a stop by 12 %.
_SAME = 0.03
_RAW_TYPE: np.dtype[np.generic] = np.dtype(np.uint16)
_RAW_CURVE = StatedCurve(LINEAR, "camera RAW", stated=True)


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
    lens
        Focal length and size of the pixels.
    """

    exposure_us: float | None = None
    shutter_us: float | None = None
    iso: float | None = None
    f_number: float | None = None
    orientation: int | None = None
    taken: datetime | None = None
    vendor: str = ""
    model: str = ""
    lens: StatedLens = field(default_factory=StatedLens)

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
        lens=stated_lens(tags),
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


@dataclass(frozen=True)
class ImageFacts:
    """Facts about an image file.

    Parameters
    ----------
    path
        The file.
    shot
        What the camera stated about the shot.
    shape, dtype
        Shape and sample type of the array that `read_image` returns; ``()`` and uint16 for camera
        RAW, of which `read_raw` returns shape, levels and colour filter with the pixels.
    transfer
        The transfer curve of the samples.
    alpha
        Whether the file has an alpha channel.
    window
        Column and row of the first pixel, and those, width and height of the display window, if a
        file (EXR, TIFF, PNG) states an offset or another display window than its pixels.
    parts
        Number of images in the file, of which the first is read; 1 for TIFF, of which all but one
        page are smaller.
    """

    path: Path
    shot: ShotFacts
    shape: tuple[int, ...] = ()
    dtype: np.dtype[np.generic] = _RAW_TYPE
    transfer: StatedCurve = _RAW_CURVE
    alpha: bool = False
    window: tuple[int, int, int, int, int, int] | None = None
    parts: int = 1

    def __str__(self) -> str:
        if not self.shape:
            return "camera RAW"
        height, width, *colours = self.shape
        return f"{width} x {height} {'RGB' if colours else 'grey'} {self.dtype}"

    def check_alike(self, first: ImageFacts) -> None:
        """Refuse an image that cannot belong to a recording with the first; unknown facts fit all.

        Raises
        ------
        DataError
            If sensitivity, aperture, orientation, data window, size or sample type differ; the
            message names both images and the tag.
        """
        mine, other = self.shot, first.shot
        settings = (
            ("ISO {:g}", "sensitivity", "PhotographicSensitivity", mine.iso, other.iso),
            ("f/{:g}", "aperture", "FNumber", mine.f_number, other.f_number),
        )
        for form, what, tag, one, two in settings:
            if one and two and abs(one / two - 1) > _SAME:
                raise DataError(
                    f"{self.path}: {what} {form.format(one)} (Exif {tag}), but {first.path.name} "
                    f"has {form.format(two)}: record all images with one {what}"
                )
        if None not in (mine.orientation, other.orientation) and (
            mine.orientation != other.orientation
        ):
            raise DataError(
                f"{self.path}: Orientation tag {mine.orientation}, but {first.path.name} has "
                f"{other.orientation}: turn the pixels of all images alike; if the camera did not "
                "move, remove the tags"
            )
        if self.window != first.window:
            raise DataError(
                f"{self.path}: data window {_place(self)}, but {first.path.name} has "
                f"{_place(first)}: save all images with the same data window"
            )
        if (self.shape, self.dtype) != (first.shape, first.dtype):
            raise DataError(
                f"{self.path}: {self}, but {first.path.name} is {first}: all images of a recording "
                "must have the same size and type"
            )


def image_facts(path: str | Path, *, max_pixels: int = MAX_PIXELS) -> ImageFacts:
    """Return the facts about an image or a camera RAW file, from its header only.

    Errors are those of `read_image` and `read_raw`, except for damage after the header.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import write_png
    >>> from acquisition.pixels import image_facts
    >>> write_png("even.png", np.full((4, 6), 7, np.uint16))
    >>> image_facts("even.png").shape
    (4, 6)
    """
    path = Path(path)
    if is_raw(path):
        exposure_us, iso, taken = read_raw_header(path)
        # The first page of a RAW file may be a preview.
        shot = shot_facts(_without_page(exif_tags(path, SHOT_TAGS)))
        return ImageFacts(
            path,
            replace(
                shot,
                exposure_us=shot.exposure_us or exposure_us,
                iso=shot.iso or iso,
                taken=shot.taken or taken,
            ),
        )
    with opened_image(path, max_pixels) as image:
        spec, kind = image.spec, image.file.format_name()
        with convert_read_errors(path):
            transfer = stated_curve(path, kind, spec)
            tags = {**xmp_tags(path, SHOT_TAGS), **exif_tags(path, SHOT_TAGS, image.page)}
    if kind == "tiff":
        tags = _without_page(tags)
    for tag, names in _ATTRIBUTES.get(kind, {}).items():
        for value in filter(None, (number_of(str(spec_attribute(spec, name))) for name in names)):
            tags[tag] = value
    window = (spec.x, spec.y, spec.full_x, spec.full_y, spec.full_width, spec.full_height)
    return ImageFacts(
        path,
        shot_facts(tags),
        shape=image.shape,
        dtype=np.dtype(image.dtype),
        transfer=transfer,
        alpha=spec.alpha_channel >= 0,
        window=None if window == (0, 0, 0, 0, spec.width, spec.height) else window,
        parts=image.parts,
    )


def _without_page(tags: Tags) -> Tags:
    """Return tags without the size of the page, which a TIFF has as stored, not as taken."""
    return {tag: value for tag, value in tags.items() if tag not in (WIDTH, HEIGHT)}


def _place(facts: ImageFacts) -> str:
    height, width = facts.shape[:2]
    x, y, *_ = facts.window or (0, 0)
    return f"{width} x {height} at ({x}, {y})"
