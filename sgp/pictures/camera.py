"""Panels of a calibrated camera: where the board was, its residuals, and its views."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from sgp.cli.terminal import printable
from sgp.pictures.sheet import Panel, rounded_down, set_plot_area

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from acquisition import CameraModel
    from calibration import CameraCalibration
    from calibration.camera import CalibratedView

_USED, _LEFT_OUT = "tab:blue", "tab:red"
_ARROW: Final = 0.04  # length of a typical residual, relative to the width of the image

_MOST_NAMES: Final = 40
_LONGEST: Final = 14


def coverage_panel(calibrated: CameraCalibration) -> Panel:
    """Show the corners in the field of view, and what lies within them."""
    camera = calibrated.camera
    title = f"{calibrated.coverage:.0%} of the field of view is covered (grey)"
    if calibrated.bare_corners:
        title += f"; not covered: {', '.join(calibrated.bare_corners)}"

    def draw(axes: Axes) -> None:
        _show_field(axes, camera)
        axes.imshow(
            np.where(calibrated.covered, 0.85, 1.0),
            cmap="gray",
            vmin=0,
            vmax=1,
            extent=(-0.5, camera.width - 0.5, camera.height - 0.5, -0.5),
            interpolation="nearest",
        )
        for one in calibrated.views:
            x, y = one.view.corners_px.T
            axes.plot(x, y, ".", ms=2.5, color=_USED if one.used else _LEFT_OUT)
        axes.plot(*camera.K[:2, 2], "+", color="black", ms=9)

    return Panel(title, draw, camera.width / camera.height)


def reprojection_panel(calibrated: CameraCalibration) -> Panel:
    """Show the residuals of all corners that were used, enlarged."""
    camera = calibrated.camera
    used = [one for one in calibrated.views if one.used]
    places = np.concatenate([one.view.corners_px[one.kept] for one in used])
    residuals = np.concatenate([one.residuals_px[one.kept] for one in used])
    factor = rounded_down(_ARROW * camera.width / max(calibrated.sigma_px * np.sqrt(2), 1e-9))
    title = f"residuals, {factor:g} times enlarged ({calibrated.sigma_px:.3f} px per coordinate)"

    def draw(axes: Axes) -> None:
        _show_field(axes, camera)
        units: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1 / factor}
        axes.quiver(*places.T, *residuals.T, **units, width=0.0015, color=_USED)

    return Panel(title, draw, camera.width / camera.height)


def views_panel(calibrated: CameraCalibration) -> Panel:
    """Show the rms of each view, the worst first; views that were left out are red."""
    views = sorted(calibrated.views, key=lambda one: -one.rms_px)[:_MOST_NAMES]
    left = sum(not one.used for one in calibrated.views)
    title = "rms of each view" + (f" ({left} left out, red)" if left else "")
    if len(calibrated.views) > len(views):
        title += f", the worst {len(views)} of {len(calibrated.views)}"

    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        rows = np.arange(len(views))
        colours = [_USED if one.used else _LEFT_OUT for one in views]
        axes.barh(rows, [one.rms_px for one in views], color=colours)
        axes.set(ylim=(len(views) - 0.5, -0.5), yticks=[])
        axes.set_xlabel("px", fontsize=8)
        axes.tick_params(labelsize=8)
        for row, one in zip(rows, views, strict=True):
            axes.annotate(
                f" {_short(one)}, {one.tilt_deg:.0f}°",
                (0, row),
                va="center",
                fontsize=7 if len(views) <= _MOST_NAMES // 2 else 5,
            ).set_parse_math(False)

    return Panel(title, draw)


def _show_field(axes: Axes, camera: CameraModel) -> None:
    axes.set_aspect("equal")
    axes.set(
        xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), xticks=[], yticks=[]
    )


def _short(one: CalibratedView) -> str:
    name = Path(one.view.name).name
    return printable(name if len(name) <= _LONGEST else f"…{name[-_LONGEST:]}")
