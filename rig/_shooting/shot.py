"""One frame and the light it was taken under."""

from __future__ import annotations

from dataclasses import dataclass

from rig._board.values import BoardEcho
from rig._camera import CameraFrame


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame and the light it was taken under.

    Parameters
    ----------
    frame
        What the camera saw.
    led
        The LED that burned during the whole exposure, None where all were dark.
    echo
        The board's word for it: its answer to the OFF that ended the shot, or its report of the
        flash or of the sequence's step.
    """

    frame: CameraFrame
    led: int | None
    echo: BoardEcho | None


def led_name(led: int | None) -> str:
    """Return an LED as messages name it."""
    return "no LED" if led is None else f"LED {led}"
