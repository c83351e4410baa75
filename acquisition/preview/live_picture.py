"""Pictures of live frames: a region at a size that a screen shows, with marks from raw values."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Final

import cv2
import numpy as np

from acquisition.preview.live_frame import LiveFrame, Region
from rig.arrays import Bool, Float32, UInt8, UInt16

# Colours of the marks (R, G, B); both differ from all grey values.
CLIPPED: Final = (255, 0, 60)
PEAKING: Final = (0, 230, 80)
# Shades of the screen for equally spaced levels of light.
_SHADES: Final = np.rint(255 * np.linspace(0, 1, 4096) ** (1 / 2.2)).astype(np.uint8)
# A sharp edge exceeds this multiple of the usual difference between a pixel and its surroundings.
_SHARP: Final = 6.0
_BAYER: Final = {
    "RGGB": cv2.COLOR_BayerRGGB2RGB,
    "BGGR": cv2.COLOR_BayerBGGR2RGB,
    "GRBG": cv2.COLOR_BayerGRBG2RGB,
    "GBRG": cv2.COLOR_BayerGBRG2RGB,
}


@dataclass(frozen=True)
class Marks:
    """What a picture marks.

    Parameters
    ----------
    clipped
        Mark pixels with a saturated sample.
    peaking
        Mark sharp edges.
    """

    clipped: bool = True
    peaking: bool = False


def picture_of(
    frame: LiveFrame, region: Region, most: tuple[int, int], marks: Marks = Marks()
) -> UInt8:
    """Return a picture of a region of a frame.

    Parameters
    ----------
    frame
        The frame.
    region
        Region of the frame; what lies outside is left out.
    most
        Largest (H, W) of the picture. Each of its pixels is the mean of a block of k x k samples,
        with the smallest whole k for which it fits; 1 shows the samples themselves.
    marks
        What to mark. A pixel of a block with one saturated sample is marked.

    Returns
    -------
    UInt8
        ``(h, w, 3)`` RGB for a screen, with gamma 2.2 between black and white level.
    """
    region = region.within(frame.size)
    block = max(1, ceil(region.height / max(1, most[0])), ceil(region.width / max(1, most[1])))
    light = _blocks(_colours(frame, region), block)
    range_dn = max(1.0, frame.white_dn - frame.black_dn)
    shares = np.clip((light - np.float32(frame.black_dn)) / np.float32(range_dn), 0, 1)
    picture = _SHADES[np.rint(shares * (_SHADES.size - 1)).astype(np.uint16)]
    if picture.ndim == 2:
        picture = np.repeat(picture[:, :, None], 3, axis=2)
    if marks.peaking:
        picture[_sharp(light)] = PEAKING
    if marks.clipped:
        picture[_blocks(frame.clipped[region.slices], block) > 0] = CLIPPED
    return np.asarray(picture, np.uint8)


def _colours(frame: LiveFrame, region: Region) -> UInt16:
    """Return the samples of a region, interpolated to ``(h, w, 3)`` for a Bayer filter."""
    samples = frame.pixels[region.slices]
    code = _BAYER.get(frame.cfa or "")
    if code is None or min(samples.shape) < 3:
        return samples
    # The pattern begins at even rows and columns: begin there, and cut afterwards.
    row, column = region.top % 2, region.left % 2
    even = Region(
        region.left - column, region.top - row, region.width + column, region.height + row
    )
    colours = cv2.cvtColor(np.ascontiguousarray(frame.pixels[even.slices]), code)
    return np.asarray(colours[row:, column:], np.uint16)


def _blocks(values: UInt16 | Bool, block: int) -> Float32:
    """Return the means of blocks; those at the right and lower border repeat their last samples."""
    samples = values.astype(np.float32)
    if block == 1:
        return samples
    down, across = (-length % block for length in values.shape[:2])
    padded = cv2.copyMakeBorder(samples, 0, down, 0, across, cv2.BORDER_REPLICATE)
    size = padded.shape[1] // block, padded.shape[0] // block
    return np.asarray(cv2.resize(padded, size, interpolation=cv2.INTER_AREA), np.float32)


def _sharp(light: Float32) -> Bool:
    """Return where a pixel differs much from its surroundings, relative to the noise of light."""
    grey = light if light.ndim == 2 else light.mean(axis=2)
    # The noise of the square root of light hardly depends on its level.
    root = np.sqrt(np.maximum(grey, 0))
    difference = np.abs(root - cv2.GaussianBlur(root, (0, 0), 1.5))
    usual = max(float(np.median(difference)), 1e-3)
    return np.asarray(difference > _SHARP * usual, bool)
