"""Callbacks of a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from acquisition._session.journal import FrameLine
from rig import Progress, no_progress

OnFrame = Callable[[FrameLine], None]
OnEvent = Callable[[str, Mapping[str, Any]], None]


@dataclass(frozen=True)
class RecordingHooks:
    """Callbacks of a recording.

    All except ``on_stop`` are called on the thread that takes the shots, between two shots.

    Parameters
    ----------
    on_frame
        Called with its line when a frame that counts is safe on disk.
    on_progress
        Receives the stage ``recording``, one step per frame that counts, and after the last shot
        the stage ``checking recorded frames`` while earlier frames are read back.
    on_event
        Called for each event that is written to the journal, with its name and details.
    on_stop
        Called inside the signal handler when Ctrl-C is pressed once.
    on_damage
        Called when a frame that was recorded earlier turns out to be damaged, with a description in
        one line. The missing shots are still taken; then the recording ends with this error.
    before_flats
        Called once before the first flat. When it returns, the white card must be under the camera,
        unless Ctrl-C was pressed meanwhile.
    """

    on_frame: OnFrame | None = None
    on_progress: Progress = no_progress
    on_event: OnEvent | None = None
    on_stop: Callable[[], None] | None = None
    on_damage: Callable[[str], None] | None = None
    before_flats: Callable[[], None] | None = None
