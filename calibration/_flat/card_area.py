"""Where a recording shows the card, and whether it is exposed well."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import Lights
from calibration._errors import EstimateError
from calibration._flat.small_card import SmallCard

Bools = npt.NDArray[np.bool_]

# Vignetting rarely leaves less than this of the light; what is darker is not the card.
_DARK = 0.3
_BINS = 160
_MOST_SATURATED = 0.005
_LEAST_COVERED = 0.5


def card_area(
    card: SmallCard, ids: Sequence[str], lights: Lights, z_mm: float, place: str
) -> Bools:
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
    cut = slice(0, rows * side), slice(0, columns * side)
    shape = (rows, side, columns, side)
    where = points_mm[side // 2 :: side, side // 2 :: side][:rows, :columns]
    light = (
        lights.vectors_at(where)[..., 2]
        * np.asarray(lights.intensities).mean(axis=1)[:, None, None]
    )
    total = np.zeros((rows, columns))
    for image in card.values:
        gray = image if image.ndim == 2 else image.mean(axis=2)
        # A saturated sample is at least white.
        filled = np.nan_to_num(gray[cut], nan=1.0)
        total += filled.reshape(shape).mean(axis=(1, 3), dtype=np.float64)
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
    area: Bools = cv2.resize(inner, (width, height), interpolation=cv2.INTER_NEAREST) > 0
    covered = float(area.mean())
    if covered < _LEAST_COVERED:
        raise EstimateError(
            f"{place}: the card covers {covered:.0%} of the image, at least {_LEAST_COVERED:.0%} "
            "are required: use a larger card, or one without a dark pattern"
        )
    _check_saturation(card, ids, area, place)
    return area


def _check_saturation(card: SmallCard, ids: Sequence[str], area: Bools, place: str) -> None:
    for name, lost in zip(ids, card.lost, strict=True):
        share = float(lost[area].mean())
        if share > _MOST_SATURATED:
            raise EstimateError(
                f"{place}: {share:.1%} of the card are saturated under light {name}, at most "
                f"{_MOST_SATURATED:.1%} may be: record it with a shorter exposure time"
            )
