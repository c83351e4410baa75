"""Images of a card, averaged over blocks while bands of rows are read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from acquisition import CameraModel, Lights
from calibration._errors import EstimateError
from calibration.flat.sites import Sites
from calibration.intensities.blocks import means_of_blocks
from calibration.radiance.stack import Stack
from rig.arrays import Bool, Float32

# The shorter side of the averaged images is at least as long; smaller images are not averaged.
_SHORTER = 256
# Bytes of the samples of all lights in a band.
_BAND = 32_000_000
# Vignetting rarely leaves less than this of the light; what is darker is not the card.
_DARK = 0.3
_BINS = 160
_MOST_SATURATED = 0.005
_LEAST_COVERED = 0.5


@dataclass(frozen=True, eq=False)
class SmallCard:
    """Block means of a recording of a card.

    Parameters
    ----------
    values
        ``(N, h, w)`` or ``(N, h, w, 3)`` linear samples; NaN where one of a block is missing. The
        sites of a mosaic are averaged by colour.
    lost
        ``(N, h, w)`` share of the pixels of each block that are saturated.
    camera
        Camera of these images.
    side
        Pixels of a block in each direction; even for a mosaic.
    """

    values: Float32
    lost: Float32
    camera: CameraModel
    side: int

    @classmethod
    def read(cls, stack: Stack, camera: CameraModel, sites: Sites) -> SmallCard:
        """Read all bands of a stack and average them."""
        height, width = sites.shape[:2]
        site = 1 if sites.cfa is None else 2
        side = site * max(1, min(height, width) // (site * _SHORTER))
        rows, columns = height // side, width // side
        many = len(stack.ids)
        shape = (many, rows, columns) if sites.colours == 1 else (many, rows, columns, 3)
        values = np.full(shape, np.nan, np.float32)
        lost = np.zeros((many, rows, columns), np.float32)
        for place, band in stack.bands(band_rows(stack, side)):
            count = (place.stop - place.start) // side
            part = slice(place.start // side, place.start // side + count)
            for k, image in enumerate(band.values):
                cut = image[: count * side, : columns * side]
                missing = ~np.isfinite(cut if cut.ndim == 2 else cut.sum(axis=2))
                lost[k, part] = means_of_blocks(missing, side)
                values[k, part] = means_of_blocks(_colours(cut, sites), side // site)
        return cls(values, lost, camera.downscaled(side), side)

    def reduced(self, mask: Bool) -> Bool:
        """Return the blocks of which all pixels of a mask ``(H, W)`` are True."""
        _, rows, columns = self.lost.shape
        cut = mask[: rows * self.side, : columns * self.side]
        return np.asarray(means_of_blocks(cut, self.side) == 1, np.bool_)

    def enlarged(self, blocks: Bool, shape: tuple[int, ...]) -> Bool:
        """Return the pixels ``(H, W)`` of blocks; those that fill no block are like the nearest."""
        whole = blocks.repeat(self.side, axis=0).repeat(self.side, axis=1)
        missing = [(0, shape[i] - whole.shape[i]) for i in range(2)]
        return np.pad(whole, missing, mode="edge")


def band_rows(stack: Stack, side: int) -> int:
    """Return a number of rows for bands, a multiple of a side."""
    shape = stack.values.shape
    of_row = 4 * math.prod(shape) // int(shape[1])
    return side * max(1, _BAND // (of_row * side))


def _colours(image: Float32, sites: Sites) -> Float32:
    """Return the colours of the 2 x 2 sites of a mosaic; other images as they are."""
    if sites.cfa is None:
        return image
    colours = np.zeros((image.shape[0] // 2, image.shape[1] // 2, 3), np.float32)
    for i, name in enumerate(sites.cfa):
        share = np.float32(1 / sites.cfa.count(name))
        colours[..., "RGB".index(name)] += image[i // 2 :: 2, i % 2 :: 2] * share
    return colours


def card_area(card: SmallCard, ids: Sequence[str], lights: Lights, z_mm: float, place: str) -> Bool:
    """Return the blocks ``(h, w)`` that show the card.

    They are the largest region whose reflectance, judged with the given lights, is at least 0.3 of
    that of its brightest part.

    Raises
    ------
    EstimateError
        If the card covers less than half of the image, or more than 0.5 % of it are saturated under
        a light.
    """
    points_mm = card.camera.points_on_plane(z_mm)
    height, width = points_mm.shape[:2]
    side = max(1, max(height, width) // _BINS)
    rows, columns = height // side, width // side
    where = points_mm[side // 2 :: side, side // 2 :: side][:rows, :columns]
    light = (
        lights.vectors_at(where)[..., 2]
        * np.asarray(lights.intensities).mean(axis=1)[:, None, None]
    )
    total = np.zeros((rows, columns))
    for image in card.values:
        gray = image if image.ndim == 2 else image.mean(axis=2)
        # A saturated sample is at least white.
        total += means_of_blocks(np.nan_to_num(gray, nan=1.0), side)
    response = total / np.maximum(light.sum(axis=0), 1e-12)
    shows = (response > _DARK * np.percentile(response, 95)).astype(np.uint8)
    count, labels, figures, _ = cv2.connectedComponentsWithStats(shows, connectivity=4)
    if count > 1:
        largest = 1 + int(figures[1:, cv2.CC_STAT_AREA].argmax())
        shows = (labels == largest).astype(np.uint8)
    filled = cv2.morphologyEx(
        np.pad(shows, 2, mode="edge"), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)
    )
    # The edge of the card is not the card; the border of the image is not its edge.
    inner = cv2.erode(filled, np.ones((3, 3), np.uint8))[2:-2, 2:-2]
    area: Bool = cv2.resize(inner, (width, height), interpolation=cv2.INTER_NEAREST) > 0
    covered = float(area.mean())
    if covered < _LEAST_COVERED:
        raise EstimateError(
            f"{place}: the card covers {covered:.0%} of the image, at least {_LEAST_COVERED:.0%} "
            "are required: use a larger card, or one without a dark pattern"
        )
    _check_saturation(card, ids, area, place)
    return area


def _check_saturation(card: SmallCard, ids: Sequence[str], area: Bool, place: str) -> None:
    for name, lost in zip(ids, card.lost, strict=True):
        share = float(lost[area].mean())
        if share > _MOST_SATURATED:
            raise EstimateError(
                f"{place}: {share:.1%} of the card are saturated under light {name}, at most "
                f"{_MOST_SATURATED:.1%} may be: record it with a shorter exposure time"
            )
