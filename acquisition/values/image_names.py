"""Names of images and lights, and when two of them are the same."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable
from pathlib import Path

IMAGE_SUFFIXES = frozenset(
    {".bmp", ".dpx", ".exr", ".hdr", ".jp2", ".jpeg", ".jpg", ".jxl", ".pgm", ".png", ".pnm"}
    | {".ppm", ".tga", ".tif", ".tiff", ".webp"}
)
# By suffix, not by content: many RAW files are also valid TIFF files that contain a thumbnail.
RAW_SUFFIXES = frozenset(
    {".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq", ".k25"}
    | {".kdc", ".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2"}
    | {".rwl", ".sr2", ".srf", ".srw", ".x3f"}
)
SUFFIXES = IMAGE_SUFFIXES | RAW_SUFFIXES


def is_raw(path: Path) -> bool:
    """Return whether a file has a suffix of camera RAW."""
    return path.suffix.lower() in RAW_SUFFIXES


def light_id(name: str) -> str:
    r"""Reduce a file name or path to the id of a light: its stem in lower case, without folders.

    Idempotent: ``chrome.0.tga``, ``D:\scan\CHROME.0.TGA`` and ``chrome.0`` all give ``chrome.0``.
    Only suffixes of images and camera RAW are removed: ``scan.left`` is unchanged.

    Examples
    --------
    >>> from acquisition.values import light_id
    >>> light_id("scan/CHROME.0.TGA")
    'chrome.0'
    """
    stem = folded(re.split(r"[\\/]", name.rstrip("\\/"))[-1])
    while True:
        shorter, _, suffix = stem.rpartition(".")
        if not shorter or f".{suffix}" not in SUFFIXES:
            return stem
        stem = shorter


def folded(name: str) -> str:
    """Return a name in lower case and one Unicode form; macOS stores accents decomposed."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def unpadded(name: str) -> str:
    """Return the light id of a name with numbers without leading zeros: ``img_1`` of ``img_01``."""
    return re.sub(r"(?<![0-9])0+(?=[0-9])", "", light_id(name))


# When two names are the same: each of these includes those before it.
SAME_NAME: tuple[Callable[[str], str], ...] = (str, folded, light_id, unpadded)
