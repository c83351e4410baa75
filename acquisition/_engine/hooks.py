"""Callbacks of a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from acquisition._session.frame_proofs import OnChecked
from acquisition._session.journal import FrameLine

OnFrame = Callable[[FrameLine, int, int], None]
OnEvent = Callable[[str, Mapping[str, Any]], None]


@dataclass(frozen=True)
class Hooks:
    """Callbacks that report progress.

    All except ``on_stop`` are called on the thread that takes the shots, between two shots.

    Parameters
    ----------
    on_frame
        Called when a frame that counts is safe on disk, with its line, the number of frames so far,
        and the total.
    on_event
        Called for each event that is written to the journal, with its name and details.
    on_stop
        Called inside the signal handler when Ctrl-C is pressed once.
    on_checked
        Called after the last shot, while frames that were recorded before are read back, with the
        number of frames read so far and the total.
    on_damage
        Called when one of these frames is damaged, with a description in one line. The missing
        shots are still taken; then the recording ends with this error.
    before_flats
        Called once before the first flat. When it returns, the white card must be under the camera,
        unless Ctrl-C was pressed meanwhile.
    """

    on_frame: OnFrame | None = None
    on_event: OnEvent | None = None
    on_stop: Callable[[], None] | None = None
    on_checked: OnChecked | None = None
    on_damage: Callable[[str], None] | None = None
    before_flats: Callable[[], None] | None = None
