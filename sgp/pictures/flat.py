"""Panels of a flat field."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

import acquisition
from rig.arrays import Float32
from sgp.pictures.crop import Crop
from sgp.pictures.maps import picture_panel
from sgp.pictures.sheet import Panel, set_plot_area

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Side of the enlarged part of the image, in pixels.
_DETAIL: Final = 64
_CONTOURS: Final = 8
_BINS: Final = 80
# Colour that is shown of a mosaic or of images in colour.
_GREEN: Final = 1


def smooth_panel(flat: acquisition.Flat) -> Panel:
    """Show the smooth part with contours in percent of the middle of the image."""
    smooth = 100 * _green(flat, flat.smooth)
    low, high = float(smooth.min()), float(smooth.max())

    def mark(axes: Axes) -> None:
        if high - low > 0.05:
            lines = axes.contour(smooth, levels=_CONTOURS, colors="white", linewidths=0.8)
            axes.clabel(lines, fmt="%g", fontsize=8)

    title, scale = "smooth part (vignetting), % of the middle", ("%", "neither")
    colours = {"cmap": "viridis", "vmin": low, "vmax": max(high, low + 1e-3)}
    return picture_panel(title, smooth, Crop.whole(smooth), scale, mark, **colours)


def pixel_panel(flat: acquisition.Flat, *, whole: bool) -> Panel:
    """Show the pixel part as deviation from 1: the image, or some pixels in its middle."""
    deviation = 100 * (_green(flat, flat.pixel) - 1)
    limit = max(float(np.quantile(np.abs(deviation), 0.99)), 1e-3)
    rows, columns = deviation.shape
    if not whole:
        side = min(_DETAIL, rows, columns)
        top, left = (rows - side) // 2, (columns - side) // 2
        deviation = deviation[top : top + side, left : left + side]
    height, width = deviation.shape
    title = "pixel part - 1" if whole else f"pixel part - 1, the middle {width} x {height} pixels"
    colours: dict[str, Any] = {
        "cmap": "RdBu_r",
        "vmin": -limit,
        "vmax": limit,
        "interpolation": "nearest",
    }
    return picture_panel(title, deviation, Crop.whole(deviation), ("%", "both"), **colours)


def histogram_panel(flat: acquisition.Flat) -> Panel:
    """Show the distribution of the pixel part, and the noise in it."""
    deviation = 100 * (flat.pixel.ravel() - 1)
    limit = max(float(np.quantile(np.abs(deviation), 0.9995)), 1e-3)
    noise = flat.pixel_std

    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        axes.hist(deviation, bins=_BINS, range=(-limit, limit), color="tab:blue", log=True)
        axes.set_xlabel("%")
        axes.set_ylabel("pixels")
        if noise is not None:
            axes.axvspan(-100 * noise, 100 * noise, color="tab:orange", alpha=0.3)

    return Panel("distribution of the pixel part - 1; orange: its noise", draw, None)


def _green(flat: acquisition.Flat, part: Float32) -> Float32:
    """Return one plane of a part: green of a mosaic, at half the resolution."""
    if part.ndim == 3:
        return part[..., _GREEN]
    if flat.cfa is None:
        return part
    at = flat.cfa.index("G")
    return part[at // 2 :: 2, at % 2 :: 2]
