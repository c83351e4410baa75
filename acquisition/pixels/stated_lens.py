"""What the metadata of an image state about lens and sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from acquisition.pixels.exif_block import Tags

# TIFF 6.0 (the size of the page) and Exif 2.32, 4.6.
WIDTH, HEIGHT = 256, 257
CHANGED, TAKEN = 306, 36867
FOCAL, PIXEL_X, PIXEL_Y = 37386, 40962, 40963
PLANE_X, PLANE_Y, PLANE_UNIT = 41486, 41487, 41488
DIGITAL_ZOOM, FOCAL_35 = 41988, 41989
LENS_TAGS: Final = (
    WIDTH, HEIGHT, CHANGED, TAKEN, FOCAL, PIXEL_X, PIXEL_Y, PLANE_X, PLANE_Y, PLANE_UNIT,
    DIGITAL_ZOOM, FOCAL_35,
)  # fmt: skip
# Millimetres in the units of the resolution: inch, which is the default, cm, mm and um.
_UNITS: Final = {2.0: 25.4, 3.0: 10.0, 4.0: 1.0, 5.0: 0.001}
# Cameras round the two resolutions on their own; pixels that differ by more are not square.
_SQUARE: Final = 0.02
# The diagonal of 35 mm film, 36 x 24 mm, from which equivalent focal lengths are computed
# (CIPA DCG-001).
FILM_DIAGONAL_MM: Final = math.hypot(36, 24)


@dataclass(frozen=True)
class StatedLens:
    """Focal length and pixels of one shot; None if the file does not state it.

    Parameters
    ----------
    focal_mm
        Focal length of the lens (FocalLength).
    focal_35_mm
        Focal length with which 35 mm film shows the same field of view (FocalLengthIn35mmFilm).
    pixels_per_mm
        Pixels on a millimetre of the sensor (FocalPlaneXResolution), for an image of `size`.
    size
        Width and height with which the camera wrote the image (PixelXDimension, PixelYDimension).
    digital_zoom
        Factor by which the camera enlarged a part of its image (DigitalZoomRatio).
    changed
        Whether a program changed the file after the shot (DateTime is not DateTimeOriginal): then
        `size` may be that of a part.
    """

    focal_mm: float | None = None
    focal_35_mm: float | None = None
    pixels_per_mm: float | None = None
    size: tuple[int, int] | None = None
    digital_zoom: float | None = None
    changed: bool = False


def stated_lens(tags: Tags) -> StatedLens:
    """Return what tags state; values without a meaning count as not stated.

    Examples
    --------
    >>> from acquisition.pixels.stated_lens import stated_lens
    >>> lens = stated_lens({37386: 50.0, 41486: 2000.0, 41488: 3.0})  # 2000 pixels on a cm
    >>> lens.focal_mm, lens.pixels_per_mm
    (50.0, 200.0)
    """
    x, y = _positive(tags, PLANE_X), _positive(tags, PLANE_Y)
    stated = tags.get(PLANE_UNIT, 2.0)
    unit = _UNITS.get(stated) if isinstance(stated, float) else None
    square = x is not None and (y is None or abs(y / x - 1) < _SQUARE)
    return StatedLens(
        focal_mm=_positive(tags, FOCAL),
        focal_35_mm=_positive(tags, FOCAL_35),
        pixels_per_mm=x / unit if x and unit and square else None,
        size=_size(tags, PIXEL_X, PIXEL_Y) or _size(tags, WIDTH, HEIGHT),
        digital_zoom=_positive(tags, DIGITAL_ZOOM),
        changed=CHANGED in tags and TAKEN in tags and tags[CHANGED] != tags[TAKEN],
    )


def _positive(tags: Tags, tag: int) -> float | None:
    value = tags.get(tag)
    return value if isinstance(value, float) and 0 < value < math.inf else None


def _size(tags: Tags, across: int, down: int) -> tuple[int, int] | None:
    width, height = _positive(tags, across), _positive(tags, down)
    return (int(width), int(height)) if width and height else None
