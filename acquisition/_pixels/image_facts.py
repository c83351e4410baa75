"""What an image file states about itself, read without decoding its pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from acquisition._errors import DataError, convert_read_errors
from acquisition._pixels.exif_block import exif_tags, number_of, xmp_tags
from acquisition._pixels.opened_image import opened_image, spec_attribute
from acquisition._pixels.raw import read_raw_header
from acquisition._pixels.shot_facts import (
    EXPOSURE_TIME,
    F_NUMBER,
    ISO_RATING,
    ORIENTATION,
    SHOT_TAGS,
    ShotFacts,
    shot_facts,
)
from acquisition._pixels.stated_curve import StatedCurve, stated_curve
from acquisition._suffixes import is_raw
from acquisition._values.transfer_curve import LINEAR
from rig import MAX_PIXELS

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
    """
    path = Path(path)
    if is_raw(path):
        exposure_us, iso, taken = read_raw_header(path)
        shot = shot_facts(exif_tags(path, SHOT_TAGS))
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
    for tag, names in _ATTRIBUTES.get(kind, {}).items():
        for value in filter(None, (number_of(str(spec_attribute(spec, name))) for name in names)):
            tags[tag] = value
    size = (spec.height, spec.width)
    window = (spec.x, spec.y, spec.full_x, spec.full_y, spec.full_width, spec.full_height)
    return ImageFacts(
        path,
        shot_facts(tags),
        shape=size if len(image.channels) == 1 else (*size, 3),
        dtype=np.dtype(image.dtype),
        transfer=transfer,
        alpha=spec.alpha_channel >= 0,
        window=None if window == (0, 0, 0, 0, spec.width, spec.height) else window,
        parts=image.parts,
    )


def _place(facts: ImageFacts) -> str:
    height, width = facts.shape[:2]
    x, y, *_ = facts.window or (0, 0)
    return f"{width} x {height} at ({x}, {y})"
