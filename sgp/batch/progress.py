"""What a batch shows while it runs: a live table on a terminal, else one line for each source."""

from __future__ import annotations

import time
from statistics import median
from typing import TYPE_CHECKING, Any, Self

from sgp.batch.task import Outcome, Task
from sgp.cli.console import note, terminal
from sgp.cli.terminal import STDERR, printable
from sgp.results import LABELS

if TYPE_CHECKING:
    from rich.console import RenderableType

_ROWS = 12


class BatchProgress:
    """Progress of a batch; a context manager.

    Parameters
    ----------
    total
        Number of tasks.
    workers
        Number of tasks that run at the same time.
    """

    def __init__(self, total: int, workers: int) -> None:
        self._total, self._workers = total, workers
        self._seconds: list[float] = []
        self._began_s = time.monotonic()
        self._running: dict[str, float] = {}
        self._done = self._failed = 0
        self._live: Any = None

    def __enter__(self) -> Self:
        if STDERR.isatty():
            from rich.live import Live

            self._live = Live(
                console=terminal(), get_renderable=self._table, transient=True, refresh_per_second=2
            )
            self._live.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        if self._live is not None:
            self._live.__exit__(*error)

    def started(self, task: Task) -> None:
        """Report that a task has begun, or waits for a worker of a cluster."""
        self._running[task.name] = time.monotonic()

    def ended(self, task: Task, outcome: Outcome) -> None:
        """Report the outcome of a task."""
        self._running.pop(task.name, None)
        self._done += 1
        self._failed += outcome.error is not None
        self._seconds.append(outcome.seconds)
        said = "done" if outcome.error is None else f"FAILED: {outcome.error}"
        if outcome.error is None and outcome.verdict in LABELS:
            said += f", {LABELS[outcome.verdict]}"
        note(f"{task.name}: {said} ({outcome.seconds:.1f} s); {self.line()}")

    def line(self) -> str:
        """Return counts, rate and the time that is left."""
        text = f"{self._done} of {self._total} done"
        if self._failed:
            text += f", {self._failed} failed"
        seconds = time.monotonic() - self._began_s
        if self._done and self._done < self._total:
            # The first tasks of each process load libraries, and a few are much larger than others.
            rounds = max((self._total - self._done) / self._workers, 1)
            left_s = rounds * median(self._seconds)
            text += f", {60 * self._done / seconds:.3g} a minute, about {_duration(left_s)} left"
        return text

    def _table(self) -> RenderableType:
        from rich.table import Table
        from rich.text import Text

        table = Table(box=None, show_header=False, pad_edge=False)
        now_s = time.monotonic()
        running = dict(self._running)
        for name, began_s in list(running.items())[:_ROWS]:
            table.add_row(Text(printable(name)), f"{now_s - began_s:.0f} s", "running")
        if len(running) > _ROWS:
            table.add_row(f"and {len(running) - _ROWS} more", "", "")
        table.add_row(Text(self.line(), style="bold"), "", "")
        return table


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
