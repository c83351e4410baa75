"""Panels of calibrated lights: their directions, and the spheres that show them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import acquisition
from rig.arrays import Float32, Float64
from sgp.cli.terminal import printable
from sgp.pictures.crop import Crop
from sgp.pictures.maps import picture_panel
from sgp.pictures.sheet import Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    from calibration import SphereCalibration
    from calibration.spheres import SphereCandidate

Box = tuple[float, float, float, float]  # left, bottom, right, top in pixels

_RINGS_DEG: Final = (30, 60, 90)
_FEW: Final = 40  # lights; more have smaller marks
_LONGEST: Final = 12  # characters of a name
_DISTANCES_PX: Final = (4, 7, 10, 13)  # from a light to its name
_AROUND: Final = np.radians([45, 0, 90, 135, 180, 225, 270, 315, 20, 70, 110, 160, 200, 250, 290])


def lights_panel(
    title: str, lights: acquisition.Lights, truth: acquisition.Lights | None = None
) -> Panel:
    """Show light directions as seen by the camera: overhead in the centre, horizon at the rim."""

    def draw(axes: Axes) -> None:
        axes.set(aspect="equal", xlim=(-1.08, 1.08), ylim=(-1.08, 1.08))
        axes.axis("off")
        axes.apply_aspect()
        angle = np.linspace(0, 2 * np.pi, 181)
        for ring in _RINGS_DEG:
            radius = np.sin(np.radians(ring))
            axes.plot(radius * np.cos(angle), radius * np.sin(angle), color="0.85", lw=1)
        axes.plot([0], [0], "+", color="0.75", ms=6)
        taken: list[Box] = []
        if truth is not None:
            where = truth.unit_directions
            axes.scatter(where[:, 0], where[:, 1], s=90, edgecolors="tab:red", facecolors="none")
            taken += _marks(axes, where, 6.5)
        where = lights.unit_directions
        size = 18 if len(lights) <= _FEW else 8
        axes.scatter(where[:, 0], where[:, 1], s=size, color="tab:blue", linewidths=0)
        taken += _marks(axes, where, np.sqrt(size / np.pi) * axes.figure.dpi / 72)
        taken += _name_rings(axes, taken)
        named = _name_lights(axes, short_names(lights.ids), where, taken)
        if named < len(lights):
            note = f"{named} of {len(lights)} lights are named"
            axes.annotate(
                note, (0.5, -0.02), xycoords="axes fraction", ha="center", va="top", fontsize=8
            )

    return Panel(title, draw, 1.0)


def short_names(ids: Sequence[str]) -> list[str]:
    """Return names of lights without the start and end that all of them share.

    The digits of numbers stay complete: ``L00``, ``L01`` give ``00``, ``01``.
    """
    start = _common_start(ids).rstrip("0123456789")
    rest = [name[len(start) :] for name in ids]
    end = _common_start([name[::-1] for name in rest])[::-1].lstrip("0123456789")
    short = [name[: len(name) - len(end)] or name for name in rest]
    if len(set(short)) < len(set(ids)) or not all(short):
        short = list(ids)
    return [printable(name if len(name) <= _LONGEST else f"…{name[-_LONGEST:]}") for name in short]


def _common_start(names: Sequence[str]) -> str:
    """Return the characters with which all names begin."""
    first, last = min(names), max(names)  # all others are between them
    same = next(
        (i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), len(first)
    )
    return first[:same]


def _marks(axes: Axes, directions: Float64, radius_px: float) -> list[Box]:
    places = axes.transData.transform(directions[:, :2])
    return [
        (x - radius_px, y - radius_px, x + radius_px, y + radius_px) for x, y in places.tolist()
    ]


def _name_rings(axes: Axes, taken: Sequence[Box]) -> list[Box]:
    """Write the angle of each ring where it covers no light."""
    found: list[Box] = []
    for ring in _RINGS_DEG:
        frame = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
        middle: dict[str, Any] = {"ha": "center", "va": "center"}
        text = axes.text(0, 0, f"{ring}°", fontsize=7, color="0.4", bbox=frame, **middle)
        width, height = _size_px(text)
        radius = np.sin(np.radians(ring))
        turns = np.radians(-90) + np.linspace(0, 2 * np.pi, 72, endpoint=False)
        for turn in turns:
            place = radius * np.cos(turn), radius * np.sin(turn)
            x, y = axes.transData.transform(place).tolist()
            box = (x - width / 2, y - height / 2, x + width / 2, y + height / 2)
            if not any(_meet(box, other) for other in (*taken, *found)):
                text.set_position(place)
                found.append(box)
                break
        else:
            text.remove()
    return found


def _name_lights(
    axes: Axes, names: Sequence[str], directions: Float64, taken: Sequence[Box]
) -> int:
    """Write names of lights that cover nothing, and return how many found a place."""
    places = axes.transData.transform(directions[:, :2])
    frame = axes.get_window_extent()
    back = axes.transData.inverted()
    boxes = [*taken]
    count = 0
    for index in _evenly(len(names)):
        text = axes.text(0, 0, names[index], fontsize=7, parse_math=False, va="bottom")
        box = _free_box(places, index, _size_px(text), boxes, frame)
        if box is None:
            text.remove()
            continue
        text.set_position(tuple(back.transform(box[:2]).tolist()))
        boxes.append(box)
        count += 1
    return count


def _evenly(count: int) -> list[int]:
    """Return the numbers of lights in the order of naming: every tenth, every fifth, the others."""
    return list(dict.fromkeys(i for step in (10, 5, 1) for i in range(0, count, step)))


def _free_box(
    places: Float64, index: int, size: tuple[float, float], taken: Sequence[Box], frame: Bbox
) -> Box | None:
    """Return a free box for the name of a light that is nearer to it than to others, or None."""
    (x, y), (width, height) = places[index].tolist(), size
    for dx, dy in _offsets(width, height):
        left, bottom = x + dx - width / 2, y + dy - height / 2
        box = left, bottom, left + width, bottom + height
        inside = left >= frame.x0 and bottom >= frame.y0
        inside = inside and box[2] <= frame.x1 and box[3] <= frame.y1
        away = np.hypot(*(places - (x + dx, y + dy)).T)
        if inside and away[index] <= away.min() and not any(_meet(box, other) for other in taken):
            return box
    return None


def _offsets(width: float, height: float) -> Iterator[tuple[float, float]]:
    """Yield offsets from a light to the middle of its name, the nearest first."""
    for distance in _DISTANCES_PX:
        for turn in _AROUND:
            yield (
                float(np.cos(turn)) * (distance + width / 2),
                float(np.sin(turn)) * (distance + height / 2),
            )


def _size_px(text: Text) -> tuple[float, float]:
    extent = text.get_window_extent()
    return extent.width + 1, extent.height + 1


def _meet(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def spheres_panel(
    title: str, brightest: Float32, estimate: SphereCalibration, recording: int = 0
) -> Panel:
    """Show outlines and highlights in one recording, over the brightest value of each pixel."""
    shown = [k for k, sphere in enumerate(estimate.spheres) if sphere.recording == recording]

    def mark(axes: Axes) -> None:
        from matplotlib.patches import Ellipse

        for k in shown:
            outline = estimate.spheres[k].outline
            a, b = outline.semi_axes_px
            axes.add_patch(
                Ellipse(
                    outline.centre_px, 2 * a, 2 * b, angle=outline.angle_deg, fill=False, ec="cyan"
                )
            )
        spots = estimate.highlights_px[:, shown].reshape(-1, 2)
        axes.scatter(spots[:, 0], spots[:, 1], s=6, color="tab:red", linewidths=0)

    return _marked(title, brightest, mark)


def candidates_panel(brightest: Float32, candidates: Sequence[SphereCandidate]) -> Panel:
    """Show numbered circles that may be spheres, over the brightest value of each pixel."""

    def mark(axes: Axes) -> None:
        from matplotlib.patches import Circle

        for number, one in enumerate(candidates, start=1):
            x, y, radius = one.circle_px
            colour = "orange" if one.lights else "cyan"
            axes.add_patch(Circle((x, y), radius, fill=False, ec=colour))
            axes.text(x, y, str(number), color=colour, ha="center", va="center")

    return _marked("no sphere was found: candidates", brightest, mark)


def _marked(title: str, brightest: Float32, mark: Callable[[Axes], None]) -> Panel:
    crop = Crop.whole(brightest)
    # Short exposures may exceed 1.
    picture = np.clip(crop.picture(brightest), 0, 1) ** (1 / 2.2)
    return picture_panel(title, picture, crop, mark=mark, cmap="gray", vmin=0, vmax=1)


def reasons_panel(candidates: Sequence[SphereCandidate]) -> Panel:
    """List the candidates of `candidates_panel` and why each is not taken for a sphere."""

    def draw(axes: Axes) -> None:
        lines = [
            f"{n}: ({one.circle_px[0]:.0f}, {one.circle_px[1]:.0f}) px, radius "
            f"{one.circle_px[2]:.0f} px\n{one.reason()}"
            for n, one in enumerate(candidates, start=1)
        ]
        text = "\n\n".join(lines)
        axes.text(0, 1, text, transform=axes.transAxes, va="top", fontsize="small")
        axes.axis("off")

    return Panel("why they were not used", draw, 1.0)
