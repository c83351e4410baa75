"""Sheets of pictures: panels in equal slots, row by row."""

from __future__ import annotations

import io
import math
import os
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import acquisition
import rig
from sgp.cli.console import shown
from sgp.cli.terminal import printable

# matplotlib is imported where it draws: the commands' help texts must not wait for it.
if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
    from matplotlib.text import Text

_VARIABLE = "MPLCONFIGDIR"


def choose_plot_folder() -> None:
    """Choose a private folder if matplotlib, before it is loaded, would find none of the user."""
    if os.environ.get(_VARIABLE):
        return
    try:
        for variable, usual in (("XDG_CONFIG_HOME", ".config"), ("XDG_CACHE_HOME", ".cache")):
            place = Path(os.environ.get(variable) or Path.home() / usual) / "matplotlib"
            place.mkdir(parents=True, exist_ok=True)
            if not os.access(place, os.W_OK):
                raise PermissionError
    except (OSError, RuntimeError):  # RuntimeError: there is no home folder
        folder = rig.kernels.private_folder()
        if folder is not None:
            os.environ[_VARIABLE] = str(folder / "matplotlib")


# Inches. A slot is the place of a picture; around it are its title, colour scale and scale bar.
_SLOT_AREA: Final = 3.4**2
_WIDEST: Final = 2.5  # aspect ratio of a slot; pictures beyond it are centred in it
_LEFT: Final = 0.12
_SCALE: Final = 0.98  # right of a slot: colour scale, its ticks and its unit
_SCALE_GAP: Final = 0.08
_SCALE_WIDTH: Final = 0.13
_TITLE: Final = 0.46  # above a slot: two lines
_BELOW: Final = 0.30
_HEADING: Final = 0.45
_DPI: Final = 100
_COLUMNS: Final = range(1, 9)
_SHEET_ASPECT: Final = 1.4  # a screen's
_EMPTY_COST: Final = 0.2


@dataclass(frozen=True)
class Panel:
    """One picture of a sheet.

    Parameters
    ----------
    title
        Text above the picture.
    draw
        Draws into axes that fill the slot.
    aspect
        Width of the picture divided by its height; None if it takes any shape.
    """

    title: str
    draw: Callable[[Axes], None]
    aspect: float | None = None


def write_overview(
    path: Path, title: str, panels: Sequence[Panel], columns: int | None = None
) -> None:
    """Arrange panels on a sheet, row by row in equal slots, and write it as a PNG.

    ``columns`` defaults to the number that gives a sheet the shape of a screen with few empty
    slots.
    """
    write_figure(path, sheet(title, panels, columns))


def sheet(title: str, panels: Sequence[Panel], columns: int | None = None) -> Figure:
    """Return the figure that `write_overview` writes; ``figure.axes`` begins with the panels."""
    choose_plot_folder()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width, height = _slot(panels)
    across, down = _LEFT + width + _SCALE, _TITLE + height + _BELOW
    columns = columns or _columns(len(panels), across / down)
    rows = -(-len(panels) // columns)
    heading = _HEADING if title else 0.0
    size = columns * across, rows * down + heading
    figure = Figure(figsize=size, dpi=_DPI)
    FigureCanvasAgg(figure)
    if title:
        top = 1 - heading / 2 / size[1]
        text = figure.text(0.5, top, "", ha="center", va="center", fontsize=14)
        _write(text, title, size[0] - 2 * _LEFT, lines=1)
    slots = []
    for index, panel in enumerate(panels):
        row, column = divmod(index, columns)
        left, bottom = column * across + _LEFT, (rows - 1 - row) * down + _BELOW
        box = (left / size[0], bottom / size[1], width / size[0], height / size[1])
        axes = figure.add_axes(box, label=f"panel {index}")
        middle = (left + width / 2) / size[0]
        text = figure.text(
            middle, (bottom + height + 0.07) / size[1], "", ha="center", va="bottom", fontsize=10.5
        )
        _write(text, panel.title, width + 1.5 * _LEFT, lines=2)
        slots.append(axes)
    for axes, panel in shown("drawing", list(zip(slots, panels, strict=True))):
        panel.draw(axes)
    return figure


def add_scale(
    axes: Axes, shown: ScalarMappable, unit: str, extend: str, ticks: Sequence[float] | None = None
) -> None:
    """Add a colour scale to the right of a panel's slot."""
    from matplotlib.ticker import ScalarFormatter

    slot = axes.get_position(original=True)
    width = _figure(axes).get_size_inches()[0]
    box = (
        slot.x1 + _SCALE_GAP / width,
        slot.y0 + 0.06 * slot.height,
        _SCALE_WIDTH / width,
        0.88 * slot.height,
    )
    scale = axes.figure.add_axes(box, label="scale")
    bar = axes.figure.colorbar(shown, cax=scale, extend=extend, ticks=ticks)
    if isinstance(bar.formatter, ScalarFormatter):
        # Complete numbers, not the differences to one above the scale.
        bar.formatter.set_useOffset(False)
        bar.update_ticks()
    bar.set_label(unit, fontsize=9, labelpad=2)
    bar.ax.tick_params(labelsize=8)


def set_plot_area(axes: Axes) -> None:
    """Shrink the axes of a plot, so that its tick and axis labels are within the slot."""
    slot = axes.get_position(original=True)
    width, height = _figure(axes).get_size_inches()
    axes.set_position(
        (
            slot.x0 + 0.5 / width,
            slot.y0 + 0.3 / height,
            slot.width - 0.3 / width,
            slot.height - 0.3 / height,
        )
    )


def rounded_down(number: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a number."""
    power = 10.0 ** math.floor(math.log10(number))
    return float(max(step * power for step in (1, 2, 5) if step * power <= number))


def source_title(source: acquisition.Source, title: str) -> str:
    """Return the title of a sheet; for a simulated recording it says so."""
    return f"SIMULATED: {title}" if source.simulated else title


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure as a PNG; the same figure gives the same bytes."""
    file = io.BytesIO()
    figure.savefig(file, format="png", metadata={"Software": None})
    acquisition.write_durably(path, file.getbuffer())


def text_size(text: Text) -> tuple[float, float]:
    """Return the width and height of a text on its figure in inches."""
    extent = text.get_window_extent()
    return extent.width / _DPI, extent.height / _DPI


def _figure(axes: Axes) -> Figure:
    figure = axes.get_figure(root=True)
    if figure is None:
        raise AssertionError("axes of a panel are on a figure")
    return figure


def _slot(panels: Sequence[Panel]) -> tuple[float, float]:
    """Return width and height of the slots in inches."""
    shapes = [panel.aspect for panel in panels if panel.aspect]
    aspect = statistics.median_low(shapes) if shapes else 1.0
    aspect = min(max(aspect, 1 / _WIDEST), _WIDEST)
    return math.sqrt(_SLOT_AREA * aspect), math.sqrt(_SLOT_AREA / aspect)


def _columns(count: int, aspect: float) -> int:
    """Return the number of columns for slots of this aspect ratio, their margins included."""

    def cost(columns: int) -> float:
        rows = -(-count // columns)
        shape = columns * aspect / rows
        return abs(math.log(shape / _SHEET_ASPECT)) + _EMPTY_COST * (-count % columns)

    return min(_COLUMNS, key=cost)


def _write(text: Text, content: str, width: float, lines: int) -> None:
    """Set a text, wrapped at words to a width in inches; what exceeds the lines is left out."""
    text.set_parse_math(False)
    rows = [""]
    words = printable(content).split(" ")
    while words:
        row = f"{rows[-1]} {words[0]}".strip()
        text.set_text(row)
        if text_size(text)[0] <= width or not rows[-1]:
            rows[-1] = row
            words.pop(0)
        else:
            rows.append("")
    rows, rest = rows[:lines], rows[lines:]
    rows[-1] = " ".join([rows[-1], *rest])
    text.set_text("\n".join(_shortened(text, row, width) for row in rows))


def _shortened(text: Text, row: str, width: float) -> str:
    """Leave out the middle of a line that is too wide: names differ at their ends."""
    kept, short = len(row), row
    while kept > 2:
        text.set_text(short)
        wide = text_size(text)[0]
        if wide <= width:
            break
        kept = max(2, min(kept - 1, int(kept * width / wide)))
        short = f"{row[: kept // 2]}…{row[-(kept - kept // 2) :]}"
    return short
