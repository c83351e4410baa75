"""Contact sheet of scenes: each lit from one side, as normals, and with the shadows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

import simulator
from rig.arrays import Float32
from sgp.pictures.sheet import choose_plot_folder, write_figure

# The conventional light of drawings: from the upper left, low enough to show relief.
_FROM = np.array([-0.6, 0.6, 0.5])
_COLUMNS = 3
_PICTURE_IN = 1.6  # height of one picture
_TITLE_IN = 0.24
_GAP, _RIM = 0.03, 0.04  # between pictures, and from the mark to the rim, in heights of a picture
_BOARD_LIT, _BOARD_DARK = 0.88, 0.5


def write_contact_sheet(path: Path, renderings: Mapping[str, simulator.Rendering]) -> None:
    """Draw three pictures of the complete frame of each rendering: lit, normals, shadows.

    They use the light nearest to the upper left. A yellow mark at the rim of the first picture
    shows the direction of this light.

    Parameters
    ----------
    path
        File to write (.png).
    renderings
        Renderings by name; all of the same size.
    """
    choose_plot_folder()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    height, width = next(iter(renderings.values())).truth.size
    aspect = width / height
    whole = 3 * aspect + 5 * _GAP  # three pictures, and space before the next scene
    rows = -(-len(renderings) // _COLUMNS)
    figure = Figure(
        figsize=(_COLUMNS * whole * _PICTURE_IN, rows * (_PICTURE_IN + _TITLE_IN)), dpi=100
    )
    FigureCanvasAgg(figure)
    for place, (name, rendering) in enumerate(renderings.items()):
        row, column = divmod(place, _COLUMNS)
        bottom = (rows - 1 - row) / rows
        share = _PICTURE_IN / (_PICTURE_IN + _TITLE_IN)
        axes = figure.add_axes((column / _COLUMNS, bottom, 1 / _COLUMNS, share / rows))
        light = upper_left_light(rendering)
        pictures = (_lit(rendering, light), _normals(rendering), _shadows(rendering, light))
        for index, picture in enumerate(pictures):
            left = _GAP + index * (aspect + _GAP)
            axes.imshow(picture, extent=(left, left + aspect, 0, 1))
            axes.add_patch(Rectangle((left, 0), aspect, 1, fill=False, ec="0.6", lw=0.5))
        toward = rendering.truth.lights.unit_directions[light, :2]
        middle = np.array([aspect / 2, 0.5])
        x, y = middle + toward * np.min((middle - _RIM) / np.maximum(np.abs(toward), 1e-9))
        axes.plot(_GAP + x, y, "o", color="gold", markersize=4.5, markeredgecolor="black")
        axes.set(xlim=(0, whole), ylim=(-_GAP, 1 + _GAP))
        axes.set_title(name, fontsize=9, pad=2)
        axes.axis("off")
    write_figure(path, figure)


def upper_left_light(rendering: simulator.Rendering) -> int:
    """Return the index of the light nearest to the upper left."""
    return int(np.argmax(rendering.truth.lights.unit_directions @ _FROM))


def _lit(rendering: simulator.Rendering, light: int) -> Float32:
    plane, truth = rendering.planes[light], rendering.truth
    matte = truth.mask if truth.mask.any() else ~np.any(truth.sphere_masks, axis=0)
    white = float(np.quantile(plane[matte], 0.995)) or 1.0
    grey = np.clip(plane / white, 0, 1) ** (1 / 2.2)
    return np.repeat(grey[..., None], 3, axis=2)


def _normals(rendering: simulator.Rendering) -> Float32:
    truth = rendering.truth
    colours = np.where(truth.mask[..., None], truth.normals / 2 + 0.5, _BOARD_LIT)
    return colours.astype(np.float32)


def _shadows(rendering: simulator.Rendering, light: int) -> Float32:
    truth = rendering.truth
    shadows = np.zeros_like(truth.mask) if truth.shadows is None else truth.shadows[light]
    board = np.where(shadows, _BOARD_DARK, _BOARD_LIT)
    grey = np.where(truth.mask, np.where(shadows, 0.0, 1.0), board).astype(np.float32)
    return np.repeat(grey[..., None], 3, axis=2)
