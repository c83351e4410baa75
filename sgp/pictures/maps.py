"""Panels of maps and images of one object."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

import acquisition
import processing
from rig.arrays import AnyArray, Bool, Float32, Floating
from sgp.pictures.crop import Crop
from sgp.pictures.sheet import Panel, add_scale, rounded_down

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The share of pixels beyond the limits of a colour scale, which would otherwise hide the others.
_EXTREME: Final = 0.01
# The quantile of the detail's slopes that the gain raises to at most 1, and the largest gain.
_STEEP: Final = 0.95
_MOST_GAIN: Final = 100
_BAR_SHARE: Final = 0.35  # of the picture's width, at most


def image_panel(
    title: str, image: acquisition.MapRows, crop: Crop, mask: Bool | None = None
) -> Panel:
    """Show a linear image, gray or RGB, with its 99.5 % quantile at white and gamma 2.2.

    NaN, which stands for saturation, is white, as is what is outside a mask.
    """
    part = crop.picture(image, mask)
    finite = part[np.isfinite(part)]
    white = float(np.quantile(finite, 0.995)) if finite.size else 0.0
    shown = np.clip(np.nan_to_num(part / (white or 1.0), nan=1.0), 0, 1) ** (1 / 2.2)
    return picture_panel(title, shown, crop, cmap="gray", vmin=0, vmax=1)


class Masked(NamedTuple):
    """Vectors ``(H, W, 3)``, which may be in a file, and the mask of those that count."""

    normals: acquisition.MapRows
    mask: Bool


def normals_panel(
    title: str, rows: processing.stages.NormalRows, crop: Crop | None = None
) -> Panel:
    """Show normals as colours: red is right, green is up, blue is toward the camera."""
    crop = crop or Crop.around(rows.mask)
    return _colours(title, crop.picture(rows.normals, rows.mask), crop)


def detail_panel(title: str, rows: processing.stages.NormalRows, crop: Crop | None = None) -> Panel:
    """Show a detail component with amplified slopes; the title states the factor."""
    crop = crop or Crop.around(rows.mask)
    normals = crop.picture(rows.normals, rows.mask)
    gain = detail_gain(normals)
    normals[..., :2] *= gain
    return _colours(f"{title}, slopes x {gain}", normals, crop)


def _colours(title: str, vectors: Float32, crop: Crop) -> Panel:
    with np.errstate(invalid="ignore", divide="ignore"):
        normals = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    colours = np.where(np.isfinite(normals), normals / 2 + 0.5, 1.0)
    return picture_panel(title, np.clip(colours, 0, 1), crop)


def detail_gain(normals: Float32) -> int:
    """Return the largest of 1, 2, 5, 10, ... that keeps 95 % of the slopes below 1."""
    slopes = np.hypot(normals[..., 0], normals[..., 1]) / np.maximum(normals[..., 2], 1e-3)
    slopes = slopes[np.isfinite(slopes)]
    steep = float(np.quantile(slopes, _STEEP)) if slopes.size else 1.0
    return max(1, int(rounded_down(1 / max(steep, 1 / _MOST_GAIN))))


def map_panel(
    title: str,
    values: acquisition.MapRows,
    unit: str,
    crop: Crop | None = None,
    *,
    error: bool = False,
    limits: tuple[float, float] | None = None,
    mask: Bool | None = None,
) -> Panel:
    """Show a scalar map with its scale; NaN is white; scales of errors start at 0.

    ``limits`` replaces the limits of the scale, which otherwise leave out the extreme pixels. What
    is outside a mask is white, too.
    """
    crop = crop or Crop.around(np.isfinite(values[:]))
    part = crop.picture(values, mask)
    finite = part[np.isfinite(part)]
    extend = "neither" if limits else "max" if error else "both"
    low, high = limits or (_error_limits(finite) if error else _limits(finite))
    cmap = "magma" if error else "viridis"
    return picture_panel(title, part, crop, (unit, extend), cmap=cmap, vmin=low, vmax=high)


def signed_panel(title: str, values: AnyArray, unit: str, crop: Crop | None = None) -> Panel:
    """Show a map with a sign: red above 0, blue below, gray at 0; NaN is white."""
    crop = crop or Crop.around(np.isfinite(values))
    part = crop.picture(values)
    _, most = _error_limits(np.abs(part[np.isfinite(part)]))
    return picture_panel(title, part, crop, (unit, "both"), cmap="coolwarm", vmin=-most, vmax=most)


def shaded_panel(
    title: str, height: acquisition.MapRows, crop: Crop | None = None, pixel_size: float = 1.0
) -> Panel:
    """Show a height map lit from the upper left, so that raised relief looks raised.

    ``height`` is in the unit of ``pixel_size``, NaN outside the object.
    """
    crop = crop or Crop.around(np.isfinite(height[:]))
    part = crop.picture(height) / np.float32(crop.step * pixel_size)
    # A single row or column has no slope across it.
    down, right = (
        np.gradient(part, axis=axis) if part.shape[axis] > 1 else np.zeros_like(part)
        for axis in (0, 1)
    )
    normals = np.stack([-right, down, np.ones_like(part)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return _lit(title, normals, crop)


def lit_panel(title: str, rows: processing.stages.NormalRows, crop: Crop | None = None) -> Panel:
    """Show a normal map lit from the upper left, as `shaded_panel` shows a height map."""
    crop = crop or Crop.around(rows.mask)
    return _lit(title, crop.picture(rows.normals, rows.mask), crop)


def _lit(title: str, normals: Floating, crop: Crop) -> Panel:
    shade = np.clip(normals @ np.array([-0.5, 0.5, 0.7071]), 0, 1)
    shown = np.where(np.isfinite(shade), 0.1 + 0.9 * shade, 1.0)
    return picture_panel(title, shown, crop, cmap="gray", vmin=0, vmax=1)


def picture_panel(
    title: str,
    picture: AnyArray,
    crop: Crop,
    scale: tuple[str, str] | None = None,
    mark: Callable[[Axes], None] | None = None,
    **colours: Any,
) -> Panel:
    """Show a picture of a crop.

    ``scale`` is the unit of its scale and its ends; ``mark`` draws on the picture.
    """

    def draw(axes: Axes) -> None:
        shown = axes.imshow(picture, extent=crop.extent, **colours)
        axes.axis("off")
        if mark is not None:
            mark(axes)
        if crop.pixel_mm is not None:
            _add_bar(axes, crop, crop.pixel_mm)
        if scale is not None:
            add_scale(axes, shown, *scale)

    return Panel(title, draw, crop.aspect)


def bar_mm(width_mm: float) -> float:
    """Return the length of a scale bar: 1, 2 or 5 times a power of ten."""
    return rounded_down(width_mm * _BAR_SHARE)


def _add_bar(axes: Axes, crop: Crop, pixel_mm: float) -> None:
    """Draw a bar of known length below the left end of a picture."""
    length = bar_mm(crop.size[1] * pixel_mm)
    left = crop.extent[0]
    below = axes.get_xaxis_transform()  # x in pixels, y in heights of the picture
    from matplotlib.transforms import ScaledTranslation

    lower = below + ScaledTranslation(0, -6 / 72, axes.figure.dpi_scale_trans)
    right = left + length / pixel_mm
    axes.plot([left, right], [0, 0], transform=lower, color="black", lw=2, clip_on=False)
    text_place = lower + ScaledTranslation(4 / 72, 0, axes.figure.dpi_scale_trans)
    axes.text(right, 0, f"{length:g} mm", transform=text_place, fontsize=8, va="center")


def _limits(finite: Float32) -> tuple[float, float]:
    if not finite.size:
        return 0.0, 1.0
    low, high = np.quantile(finite, [_EXTREME / 2, 1 - _EXTREME / 2])
    return float(low), float(max(high, low + 1e-9))


def _error_limits(finite: Float32) -> tuple[float, float]:
    most = float(np.quantile(finite, 1 - _EXTREME)) if finite.size else 0.0
    return 0.0, max(most, 1e-9)
