"""Bar charts as drawings in the page, with a unit on the axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from sgp._report.html import Html, tag

# As wide as a phone: letters have about the size of the page's on all windows.
_WIDTH: Final = 360
_HEIGHT: Final = 140
_LEFT, _TOP, _BOTTOM = 44, 26, 20
_LETTER: Final = 7  # width of a letter of a label


def bar_chart(title: str, names: Sequence[str], values: Sequence[float]) -> Html:
    """Return bars from 0; values that are not finite have none. ``title`` states the unit."""
    known = [value for value in values if math.isfinite(value)]
    most = max([0.0, *known]) or 1.0
    step = _step(most)
    top = step * math.ceil(most / step - 1e-9)
    tall, wide = _HEIGHT - _TOP - _BOTTOM, (_WIDTH - _LEFT) / max(len(values), 1)

    def down(value: float) -> float:
        return round(_TOP + tall * (1 - value / top), 1)

    parts = [tag("text", title, x=0, y=13, class_="title")]
    for place in range(round(top / step) + 1):
        y = down(place * step)
        parts += [
            tag("line", x1=_LEFT, x2=_WIDTH, y1=y, y2=y, class_="grid"),
            tag("text", f"{place * step:.4g}", x=_LEFT - 5, y=y + 4, text_anchor="end"),
        ]
    labels = [name if len(name) <= 8 else f"…{name[-6:]}" for name in names]
    longest = max(map(len, labels), default=0)
    every = max(1, math.ceil(_LETTER * (longest + 1) / wide))
    for place, (name, value) in enumerate(zip(names, values, strict=True)):
        x = _LEFT + place * wide
        if math.isfinite(value):
            y = down(max(value, 0.0))
            bar = tag("title", f"{name}: {value:.3g}")
            parts.append(
                tag(
                    "rect",
                    bar,
                    x=round(x + 0.15 * wide, 1),
                    y=y,
                    width=round(0.7 * wide, 1),
                    height=round(_TOP + tall - y, 1),
                )
            )
        if place % every == 0:
            middle = round(x + wide / 2, 1)
            parts.append(tag("text", labels[place], x=middle, y=_HEIGHT - 6, text_anchor="middle"))
    return tag(
        "svg",
        parts,
        viewBox=f"0 0 {_WIDTH} {_HEIGHT}",
        class_="chart",
        role="img",
        aria_label=f"{title}, for {len(values)} lights",
    )


def _step(most: float) -> float:
    """Return a round distance of grid lines, so that there are two to four below ``most``."""
    power = 10.0 ** math.floor(math.log10(most))
    return next(m * power for m in (0.25, 0.5, 1, 2.5, 5) if most / (m * power) <= 4)
