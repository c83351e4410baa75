"""The overview picture: inputs, lights, normals, shape, detail, height and surface."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

import acquisition
import processing
import rig
from sgp._console import Stages

# matplotlib is imported where it draws: the commands' help texts must not wait for it.
if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from calibration import SphereCalibration

Image = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Panel:
    """One picture of the sheet: its title and the function that draws it."""

    title: str
    draw: Callable[[Axes], None]


def write_overview(
    path: Path, title: str, panels: Sequence[Panel], columns: int | None = None
) -> None:
    """Arrange panels on a sheet, row by row, and write it as a PNG.

    ``columns`` defaults to 4, or to 3 or 5 if that leaves fewer places empty.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = columns or min((4, 3, 5), key=lambda width: -len(panels) % width)
    rows = -(-len(panels) // columns)
    figure = Figure(
        figsize=(4.0 * columns, 3.7 * rows + 0.5 * bool(title)), layout="constrained", dpi=100
    )
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(_drawable(title), fontsize=14, parse_math=False)
    with Stages() as progress:
        # Each panel is prepared, placed and drawn.
        report = _Count(progress, 3 * len(panels))
        for index, panel in enumerate(panels):
            axes = figure.add_subplot(rows, columns, index + 1)
            axes.set_title(_drawable(panel.title), fontsize=11, parse_math=False)
            panel.draw(axes)
            report.count()
            _after_drawing(axes, report.count)
        write_figure(path, figure)


class _Count:
    """Counts the steps of a drawing; matplotlib may draw some of them more than once."""

    def __init__(self, progress: rig.Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0
        progress("drawing", 0, total)

    def count(self) -> None:
        self._done = min(self._done + 1, self._total)
        self._progress("drawing", self._done, self._total)


def _after_drawing(axes: Axes, call: Callable[[], None]) -> None:
    """Call a function whenever axes were drawn, by an artist on top that draws nothing."""
    from matplotlib.artist import Artist

    class Last(Artist):
        zorder = 1e9

        def draw(self, renderer: object) -> None:
            call()

    last = Last()
    last.set_in_layout(False)
    axes.add_artist(last)


def source_title(source: acquisition.Source, title: str) -> str:
    """Return the title of a sheet; for a simulated recording it says so."""
    return f"SIMULATED: {title}" if source.simulated else title


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure as a PNG; the same figure gives the same bytes."""
    file = io.BytesIO()
    figure.savefig(file, format="png", metadata={"Software": None})
    acquisition.write_durably(path, file.getbuffer())


def _drawable(text: str) -> str:
    """Escape surrogates, which are in names that are not UTF-8."""
    return text.encode("utf-8", "backslashreplace").decode()


def image_panel(title: str, image: Image, mask: npt.NDArray[np.bool_]) -> Panel:
    """Show a linear image around a mask, with its 99.5 % quantile at white and gamma 2.2."""
    image = image[_box(mask)]

    def draw(axes: Axes) -> None:
        finite = image[np.isfinite(image)]
        white = float(np.quantile(finite, 0.995)) if finite.size else 0.0
        shown = np.nan_to_num(image / (white or 1.0), nan=1.0)
        axes.imshow(np.clip(shown, 0, 1) ** (1 / 2.2), cmap="gray", vmin=0, vmax=1)
        axes.axis("off")

    return Panel(title, draw)


def normals_panel(title: str, normal_map: processing.NormalMap) -> Panel:
    """Show normals as colours: red is right, green is up, blue is toward the camera."""

    def draw(axes: Axes) -> None:
        colours = np.where(normal_map.mask[..., None], normal_map.normals / 2 + 0.5, 1.0)
        axes.imshow(np.clip(colours, 0, 1)[_box(normal_map.mask)])
        axes.axis("off")

    return Panel(title, draw)


def map_panel(title: str, values: Image, unit: str, *, error: bool = False) -> Panel:
    """Show a scalar map with its scale; NaN is white; scales of errors start at 0."""

    def draw(axes: Axes) -> None:
        finite = values[np.isfinite(values)]
        low, high = (0.0, float(np.quantile(finite, 0.99))) if error else _range(finite)
        box = _box(np.isfinite(values))
        shown = axes.imshow(values[box], cmap="magma" if error else "viridis", vmin=low, vmax=high)
        axes.axis("off")
        beyond = "max" if error else "both"  # the scale excludes the most extreme pixels
        axes.figure.colorbar(shown, ax=axes, label=unit, shrink=0.8, extend=beyond)

    return Panel(title, draw)


def shaded_panel(title: str, height: Image) -> Panel:
    """Show a height map lit from the upper left, so that raised relief looks raised.

    ``height`` is in units of one pixel, NaN outside the object.
    """

    def draw(axes: Axes) -> None:
        down, right = np.gradient(height)
        normals = np.stack([-right, down, np.ones_like(height)], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        light = np.array([-0.5, 0.5, 0.7071])
        shade = np.clip(normals @ light, 0, 1)
        shown = np.where(np.isfinite(shade), 0.1 + 0.9 * shade, 1.0)
        axes.imshow(shown[_box(np.isfinite(height))], cmap="gray", vmin=0, vmax=1)
        axes.axis("off")

    return Panel(title, draw)


def spheres_panel(title: str, values: Image, estimate: SphereCalibration) -> Panel:
    """Show the detected outlines and highlights over the brightest value of each pixel."""
    from matplotlib.patches import Ellipse

    def draw(axes: Axes) -> None:
        # Saturated values are NaN, short exposures may exceed 1: both are white here.
        brightest = np.zeros(values.shape[1:], np.float32)
        for image in values:
            np.maximum(brightest, np.nan_to_num(image, nan=1.0), out=brightest)
        axes.imshow(np.clip(brightest, 0, 1) ** (1 / 2.2), cmap="gray", vmin=0, vmax=1)
        for sphere in estimate.spheres:
            outline = sphere.outline
            a, b = outline.semi_axes_px
            axes.add_patch(
                Ellipse(
                    outline.centre_px, 2 * a, 2 * b, angle=outline.angle_deg, fill=False, ec="cyan"
                )
            )
        spots = estimate.highlights_px.reshape(-1, 2)
        axes.scatter(spots[:, 0], spots[:, 1], s=6, color="tab:red", linewidths=0)
        axes.axis("off")

    return Panel(title, draw)


def lights_panel(
    title: str, lights: acquisition.Lights, truth: acquisition.Lights | None = None
) -> Panel:
    """Show light directions as seen by the camera: overhead in the centre, horizon at the rim."""

    def draw(axes: Axes) -> None:
        angle = np.linspace(0, 2 * np.pi, 181)
        for ring in (30, 60, 90):
            radius = np.sin(np.radians(ring))
            axes.plot(radius * np.cos(angle), radius * np.sin(angle), color="0.85", lw=1)
        if truth is not None:
            where = truth.unit_directions
            axes.scatter(where[:, 0], where[:, 1], s=90, edgecolors="tab:red", facecolors="none")
        where = lights.unit_directions
        axes.scatter(where[:, 0], where[:, 1], s=18, color="tab:blue")
        for name, (x, y, _) in zip(lights.ids, where, strict=True):
            if len(lights) <= 40:
                short = name.rsplit(".", 1)[-1].removeprefix("L")
                axes.annotate(
                    short,
                    (x, y),
                    xytext=(3, 3),
                    textcoords="offset points",
                    fontsize=7,
                    parse_math=False,
                )
        axes.set_aspect("equal")
        axes.set_xlim(-1.05, 1.05)
        axes.set_ylim(-1.05, 1.05)
        axes.axis("off")

    return Panel(title, draw)


def profile_panel(title: str, profile: processing.HeightProfile) -> Panel:
    """Plot a result's heights, raw and smoothed, in ascending order of the target's heights."""
    from matplotlib.ticker import EngFormatter, MaxNLocator

    def draw(axes: Axes) -> None:
        pick = profile.ranks()
        smoothed, result, target = (
            heights[pick] for heights in (profile.smoothed, profile.result, profile.target)
        )
        # The mean is within the scatter of the result: small dots on large ones show both.
        axes.plot(pick, result, ".", color="tab:green", ms=5, mew=0, label="result")
        axes.plot(pick, smoothed, ".", color="tab:red", ms=2, mew=0, label="result, 5 x 5 mean")
        axes.plot(pick, target, "-", color="tab:blue", label="target, sorted")
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.set_xlabel("pixel, in ascending order of the target's height")
        axes.set_ylabel(f"height ({profile.unit})")
        axes.legend(loc="upper left", fontsize=8, markerscale=2)

    return Panel(title, draw)


def _range(finite: Image) -> tuple[float, float]:
    low, high = np.quantile(finite, [0.005, 0.995])
    return float(low), float(max(high, low + 1e-9))


def _box(mask: npt.NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the slices of a picture that contain the mask, with a margin around it."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    margin = 2 + max(len(rows), len(columns)) // 50
    return (
        slice(max(rows[0] - margin, 0), rows[-1] + 1 + margin),
        slice(max(columns[0] - margin, 0), columns[-1] + 1 + margin),
    )
