"""All scenes on one sheet: lit from one side, as normals, and with the shadows of that light."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from simulator import Rendering

Picture = npt.NDArray[np.float32]

# The light that draughtsmen use: upper left, and low enough that relief shows.
_FROM = np.array([-0.6, 0.6, 0.5])
_COLUMNS = 3
_PICTURE_IN = 1.45
_TITLE_IN = 0.24
_AIR = 1.2  # how much wider than the object a picture is
_BOARD_LIT, _BOARD_DARK = 0.88, 0.5


def write_contact_sheet(path: Path, renderings: Mapping[str, Rendering]) -> None:
    """Draw three pictures of each rendering: lit, normals, shadows.

    All are of the light nearest to the upper left; a yellow mark on the rim of the first picture
    stands on the side that it comes from.

    Parameters
    ----------
    path
        A .png.
    renderings
        By name.
    """
    rows = -(-len(renderings) // _COLUMNS)
    figure = Figure(
        figsize=(_COLUMNS * 3.15 * _PICTURE_IN, rows * (_PICTURE_IN + _TITLE_IN)), dpi=100
    )
    FigureCanvasAgg(figure)
    for place, (name, rendering) in enumerate(renderings.items()):
        row, column = divmod(place, _COLUMNS)
        bottom = (rows - 1 - row) / rows
        share = _PICTURE_IN / (_PICTURE_IN + _TITLE_IN)
        axes = figure.add_axes((column / _COLUMNS, bottom, 0.96 / _COLUMNS, share / rows))
        light = upper_left_light(rendering)
        box = _box(rendering.truth.mask)
        pictures = (_lit(rendering, light), _normals(rendering), _shadows(rendering, light))
        for index, picture in enumerate(pictures):
            axes.imshow(picture[box], extent=(index, index + 0.98, 0, 0.98))
        toward = rendering.truth.lights.unit_directions[light, :2]
        x, y = 0.49 + 0.47 * toward / np.abs(toward).max()
        axes.plot(x, y, "o", color="gold", markersize=5, markeredgecolor="black")
        axes.set(xlim=(0, 2.98), ylim=(0, 0.98))
        axes.set_title(name, fontsize=9, pad=2)
        axes.axis("off")
    figure.savefig(path, metadata={"Software": None})


def upper_left_light(rendering: Rendering) -> int:
    """Return the index of the light nearest to the upper left."""
    return int(np.argmax(rendering.truth.lights.unit_directions @ _FROM))


def _box(mask: npt.NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return a square around the object, or without one the middle of the image."""
    where = np.nonzero(mask)
    half = min(mask.shape) / 2
    centre = np.array(mask.shape) / 2
    if len(where[0]):
        low, high = np.min(where, axis=1), np.max(where, axis=1) + 1
        half = min(half, float(_AIR * (high - low).max() / 2))
        centre = (low + high) / 2
    first = np.clip(np.round(centre - half), 0, np.array(mask.shape) - int(2 * half)).astype(int)
    return slice(first[0], first[0] + int(2 * half)), slice(first[1], first[1] + int(2 * half))


def _lit(rendering: Rendering, light: int) -> Picture:
    plane, truth = rendering.planes[light], rendering.truth
    matte = truth.mask if truth.mask.any() else ~np.any(truth.sphere_masks, axis=0)
    white = float(np.quantile(plane[matte], 0.995)) or 1.0
    grey = np.clip(plane / white, 0, 1) ** (1 / 2.2)
    return np.repeat(grey[..., None], 3, axis=2)


def _normals(rendering: Rendering) -> Picture:
    truth = rendering.truth
    colours = np.where(truth.mask[..., None], truth.normals / 2 + 0.5, _BOARD_LIT)
    return colours.astype(np.float32)


def _shadows(rendering: Rendering, light: int) -> Picture:
    truth = rendering.truth
    shadows = np.zeros_like(truth.mask) if truth.shadows is None else truth.shadows[light]
    board = np.where(shadows, _BOARD_DARK, _BOARD_LIT)
    grey = np.where(truth.mask, np.where(shadows, 0.0, 1.0), board).astype(np.float32)
    return np.repeat(grey[..., None], 3, axis=2)
