"""A frame and the LED under which it was taken."""

from __future__ import annotations

from dataclasses import dataclass

from rig.board.values import BoardEcho
from rig.camera.interface import CameraFrame


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame and the LED under which it was taken.

    Parameters
    ----------
    frame
        Frame from the camera.
    led
        The LED that was on during the complete exposure, None if all were off.
    echo
        The board's confirmation: its reply to the OFF that ended the shot, or its report of the
        flash or of the sequence's step.
    """

    frame: CameraFrame
    led: int | None
    echo: BoardEcho | None

    def __repr__(self) -> str:
        return f"Shot({led_name(self.led)}, {self.frame!r})"


def led_name(led: int | None) -> str:
    """Return the name of an LED for messages."""
    return "no LED" if led is None else f"LED {led}"
