"""What is known of the weights that come with the sources: their training and its losses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from sgp.pictures import Panel, set_plot_area


def description(weights: Path) -> dict[str, Any]:
    """Return the description that was written next to a file of weights."""
    read: dict[str, Any] = json.loads(weights.with_suffix(".json").read_text(encoding="utf-8"))
    return read


def training_note(weights: Path) -> str:
    """Return what a training took, and whether its loss became flat."""
    described = description(weights)
    training = described["training"]
    text = (
        f"trained in {training['cpu_s'] / 60:.0f} CPU minutes ({training['wall_s'] / 60:.0f} "
        "minutes on a busy machine)"
    )
    return text if described["converged"] else f"{text}, NOT CONVERGED"


def loss_panel(title: str, weights: Path) -> Panel:
    """Return a panel with the losses of a training, of each level if there are several."""
    losses = description(weights)["losses"]
    curves = losses if isinstance(losses[0], list) else [losses]

    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        for number, curve in enumerate(curves, 1):
            axes.semilogy([100 * at / len(curve) for at in range(len(curve))], curve)
            if len(curves) > 1:
                axes.text(100, curve[-1], f"level {number}")
        axes.set_xlabel("training, %")
        axes.tick_params(which="both", labelsize=7)

    return Panel(title, draw)
