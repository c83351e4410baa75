"""Who is told while a recording goes on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from acquisition._session.journal import FrameLine
from rig import Progress, no_progress

OnFrame = Callable[[FrameLine], None]
OnEvent = Callable[[str, Mapping[str, Any]], None]


@dataclass(frozen=True)
class Hooks:
    """Who is told what; all are called on the thread that takes the shots, between two of them.

    Parameters
    ----------
    on_frame
        A frame that counts is safe on the disk: its line.
    on_progress
        Receives the stage ``recording``, one step per frame that counts, and the stage ``checking
        recorded frames`` while frames of earlier processes are still read back at the end.
    on_event
        An event that goes to the journal: its name and details.
    on_stop
        Ctrl-C was pressed once. Called in a signal handler.
    on_damage
        One of them is damaged: what is wrong, as one line. The shots that are missing are taken all
        the same; then the recording ends with this error.
    before_flats
        The white card must lie under the camera when this returns, unless Ctrl-C was pressed
        meanwhile. Called once.
    """

    on_frame: OnFrame | None = None
    on_progress: Progress = no_progress
    on_event: OnEvent | None = None
    on_stop: Callable[[], None] | None = None
    on_damage: Callable[[str], None] | None = None
    before_flats: Callable[[], None] | None = None
