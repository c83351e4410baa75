"""The comparison of repeats with their light while further shots are taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from acquisition.engine.write_queue import Turn, WriteQueue
from acquisition.session.comparisons import compared_repeats, earlier_repeats, findings
from acquisition.session.journal import COMPARED
from acquisition.session.session import Session
from rig import Notice

# Comparisons that the journal has, and new ones.
_Results = tuple[Sequence[Mapping[str, Any]], Sequence[Mapping[str, Any]]]


class RepeatWatch:
    """Compares repeats that are on disk, in a separate thread: this takes about a second.

    Parameters
    ----------
    folder
        The session.
    stall_s
        Longest time for a comparison, seconds.
    """

    def __init__(self, folder: Path, stall_s: float) -> None:
        self._folder = folder
        self._stall_s = stall_s
        # Most recordings need no thread.
        self._queue: WriteQueue[_Results] | None = None
        self._known: list[Mapping[str, Any]] = []
        self.findings: list[Notice] = []

    @property
    def settled(self) -> bool:
        """Whether every comparison is done and was collected."""
        return self._queue is None or self._queue.settled

    def compare(self, file: str) -> None:
        """Begin to compare a repeat, named as in its line."""
        self._queue = self._queue or WriteQueue(
            self._folder, room=1, threads=1, stall_s=self._stall_s
        )
        self._queue.put(partial(self._compared, file))

    def wait(self) -> None:
        """Wait until every comparison is done."""
        if self._queue is not None:
            self._queue.drain()

    def collect(self) -> list[Mapping[str, Any]]:
        """Return the details of new comparisons, and add what they show to `findings`.

        Raises
        ------
        DataError
            If a frame is damaged.
        """
        collected = len(self._known)
        for journal, new in () if self._queue is None else self._queue.results():
            for details in new:
                found = findings(details, earlier_repeats(details, [*journal, *self._known]))
                self.findings += [
                    replace(one, where=str(self._folder / one.where)) for one in found
                ]
                self._known.append(details)
        return self._known[collected:]

    def end(self, patience_s: float) -> None:
        """Discard waiting comparisons, and wait for the one that runs."""
        if self._queue is not None:
            self._queue.end(patience_s)

    def _compared(self, file: str, turn: Turn) -> _Results:
        turn()
        session = Session.open(self._folder)
        journal = [line.details for line in session.events if line.event == COMPARED]
        return journal, [*compared_repeats(session, file)]
