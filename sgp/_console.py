"""What a person sees while work goes on: progress and notes on stderr, never on stdout."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

Advance = Callable[[int, int], None]

_stderr = Console(stderr=True, highlight=False)


def note(text: str) -> None:
    """Say one line to the person at the terminal."""
    _stderr.print(text, markup=False, soft_wrap=True)


@contextmanager
def progress(what: str) -> Iterator[Advance]:
    """Show a bar on a terminal, nothing elsewhere; yields ``advance(done, total)``."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda done, total: None
        return
    columns = (
        TextColumn("{task.description:<24}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=_stderr, transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
