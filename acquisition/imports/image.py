"""One image for import: its samples and the metadata that the camera wrote."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition._errors import DataError
from acquisition.pixels.camera_raw import read_raw
from acquisition.pixels.images import Image, read_image
from acquisition.pixels.stated_facts import ImageFacts, image_facts
from acquisition.values.image_names import is_raw
from rig import MAX_PIXELS
from rig.arrays import UInt16

# Some cameras measure the black level for each frame: allowed difference, relative to white.
_BLACK_SLACK = 0.001


@dataclass(frozen=True, eq=False)
class ImportedImage:
    """An image in the form in which a session stores it.

    Parameters
    ----------
    facts
        What the file states.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` uint16; 8-bit samples keep their values.
    bit_depth
        Number of significant low bits of a sample.
    cfa, black_level_dn, white_level_dn
        Colour filter pattern of a mosaic, or None, and the levels of the samples.
    black_levels_dn
        Black level at each position of the filter's block; empty without a colour filter.
    """

    facts: ImageFacts
    pixels: UInt16
    bit_depth: int
    cfa: str | None
    black_level_dn: float
    white_level_dn: float
    black_levels_dn: tuple[float, ...] = ()

    @property
    def path(self) -> Path:
        """The image file."""
        return self.facts.path

    def check_like(self, first: ImportedImage) -> None:
        """Refuse an image that cannot belong to the same recording as the first.

        Raises
        ------
        DataError
            If shape, colour filter or levels differ.
        """
        facts = (
            ("pixels", self.pixels.shape, first.pixels.shape),
            ("bits", self.bit_depth, first.bit_depth),
            ("colour filter", self.cfa, first.cfa),
            ("white level", self.white_level_dn, first.white_level_dn),
        )
        differing = [(name, one, other) for name, one, other in facts if one != other]
        one, other = self.black_level_dn, first.black_level_dn
        if abs(one - other) > _BLACK_SLACK * self.white_level_dn:
            differing.append(("black level", one, other))
        if differing:
            name, mine, firsts = differing[0]
            raise DataError(
                f"{self.path}: {name} {_text(mine)}, but {first.path.name} has {_text(firsts)}: "
                "all images of a recording must be of the same kind and camera settings"
            )


def read_for_import(path: Path, *, max_pixels: int = MAX_PIXELS) -> ImportedImage:
    """Read an image or a camera RAW file with its metadata.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is damaged, of an unknown format, has more than ``max_pixels`` pixels, or holds
        float samples.
    """
    facts = image_facts(path, max_pixels=max_pixels)
    if not is_raw(path):
        return imported_image(facts, read_image(path, max_pixels=max_pixels))
    raw = read_raw(path, max_pixels=max_pixels)
    return ImportedImage(
        facts,
        raw.pixels,
        bit_depth=max(8, int(raw.white_level_dn).bit_length()),
        cfa=raw.cfa,
        black_level_dn=raw.black_level_dn,
        white_level_dn=raw.white_level_dn,
        black_levels_dn=raw.black_levels_dn,
    )


def imported_image(facts: ImageFacts, pixels: Image) -> ImportedImage:
    """Build an imported image from pixels that were already read.

    Raises
    ------
    DataError
        If the pixels are floats.
    """
    if pixels.dtype.kind != "u":
        raise DataError(
            f"{facts.path}: a session holds whole numbers: save the image as 8 or 16 bit"
        )
    bits = 8 * pixels.dtype.itemsize
    return ImportedImage(
        facts,
        pixels.astype(np.uint16),
        bit_depth=bits,
        cfa=None,
        black_level_dn=0.0,
        white_level_dn=float(2**bits - 1),
    )


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value)
