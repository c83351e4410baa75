"""What the XMP packet of an image file states about the shot."""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from pathlib import Path
from typing import Final

from acquisition._pixels.tiff_tags import Tags

# XMP, part 2: the properties have the names of Exif's tags.
_TAG_OF: Final = {
    "ExposureTime": 33434, "FNumber": 33437, "ISOSpeedRatings": 34855,
    "PhotographicSensitivity": 34855, "ShutterSpeedValue": 37377, "ApertureValue": 37378,
}  # fmt: skip
# An attribute, an element, or the first item of a list in it.
_PROPERTY: Final = re.compile(
    rb"\bexif(?:EX)?:(" + "|".join(_TAG_OF).encode() + rb")(?:\s*=\s*[\"']|>\s*"
    rb"(?:<rdf:Seq[^>]*>\s*<rdf:li[^>]*>\s*)?)([0-9./eE+-]{1,40})\s*[\"'<]"
)
_BEGIN, _FINISH = b"<x:xmpmeta", b"</x:xmpmeta>"
# XMP, part 3: a packet can be found without its container. It is before or after the samples.
_SEARCHED: Final = 1 << 18


def xmp_tags(path: Path, wanted: Collection[int]) -> Tags:
    """Return the wanted tags that the first packet of a file states; none without a packet."""
    with path.open("rb") as file:
        data = file.read(_SEARCHED)
        end = file.seek(0, 2)
        file.seek(max(end - _SEARCHED, len(data)))
        data += file.read()
    begin = data.find(_BEGIN)
    packet = data[begin : data.find(_FINISH, begin)] if begin >= 0 else b""
    tags: Tags = {}
    for name, value in _PROPERTY.findall(packet):
        number = number_of(value.decode("ascii"))
        tag = _TAG_OF[name.decode("ascii")]
        if number is not None and tag in wanted:
            tags.setdefault(tag, number)
    return tags


def number_of(text: str) -> float | None:
    """Return the value of a number or a rational such as ``1/60``; None if it is neither.

    Examples
    --------
    >>> from acquisition._pixels.xmp_packet import number_of
    >>> number_of("1/80"), number_of("0/0")
    (0.0125, None)
    """
    numerator, _, denominator = text.partition("/")
    try:
        value = float(numerator) / float(denominator or 1)
    except (ValueError, ZeroDivisionError, OverflowError):
        return None
    return value if math.isfinite(value) else None
