"""The comparison of repeats with their light while further shots are taken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from acquisition.engine.write_queue import Turn, WriteQueue
from acquisition.session.comparisons import compared_repeats, earlier_repeats, findings
from acquisition.session.journal import COMPARED
from acquisition.session.session import Session
from rig import Notice


class RepeatWatch:
    """Compares repeats that are on disk, in a thread of its own: this takes about a second.

    Parameters
    ----------
    folder
        The session.
    stall_s
        Longest time for a comparison, seconds.
    """

    def __init__(self, folder: Path, stall_s: float) -> None:
        self._folder = folder
        self._queue: WriteQueue[list[dict[str, Any]]] = WriteQueue(
            folder, room=1, threads=1, stall_s=stall_s
        )
        events = Session.open(folder).events
        self._known = [line.details for line in events if line.event == COMPARED]
        self.findings: list[Notice] = []

    @property
    def settled(self) -> bool:
        """Whether every comparison is done and was collected."""
        return self._queue.settled

    def compare(self, file: str) -> None:
        """Begin to compare a repeat, named as in its line."""
        self._queue.put(partial(self._compared, file))

    def wait(self) -> None:
        """Wait until every comparison is done."""
        self._queue.drain()

    def collect(self) -> list[Mapping[str, Any]]:
        """Return the details of new comparisons, and add what they show to `findings`.

        Raises
        ------
        DataError
            If a frame is damaged.
        """
        new = [details for results in self._queue.results() for details in results]
        for details in new:
            found = findings(details, earlier_repeats(details, self._known))
            self.findings += [replace(one, where=str(self._folder / one.where)) for one in found]
            self._known.append(details)
        return [*new]

    def end(self, patience_s: float) -> None:
        """Discard waiting comparisons, and wait for the one that runs."""
        self._queue.end(patience_s)

    def _compared(self, file: str, turn: Turn) -> list[dict[str, Any]]:
        turn()
        return [*compared_repeats(Session.open(self._folder), file)]
