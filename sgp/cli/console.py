"""Progress bars and notes, on stderr and never on stdout."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, ClassVar, ParamSpec, Self, TypeVar

from rig import Notice
from rig.kernels import KernelWatch
from sgp.cli.terminal import STDERR, coloured, fitted, printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

P = ParamSpec("P")
T = TypeVar("T")
Advance = Callable[[int, int], None]

# Interval between lines of progress if stderr is not a terminal.
_LINE_EVERY_S = 10.0
# Notices that this command line has reported.
_REPORTED: set[str] = set()


class Listener:
    """Hears what the console shows; this one ignores it."""

    def notice(self, notice: Notice, /) -> None:
        """Hear a notice, once for each command line."""

    def progress(self, stage: str, done: int, total: int, /) -> None:
        """Hear a step of the stage that is shown."""


_LISTENERS: list[Listener] = []


def listen(listener: Listener) -> None:
    """Add a listener until the end of the command line."""
    _LISTENERS.append(listener)


def note(text: str) -> None:
    """Print one line to stderr."""
    if STDERR.isatty():  # a bar may be on display, above which the console inserts the line
        from rich.text import Text

        line = coloured(fitted(printable(text), STDERR), STDERR)
        terminal().print(Text.from_ansi(line), soft_wrap=True)
    else:
        print(printable(text), file=STDERR)


def report(notice: Notice) -> None:
    """Print a notice with its severity, once for each command line."""
    line = f"{notice.label}: {notice}"
    if line not in _REPORTED:
        _REPORTED.add(line)
        note(line)
        for listener in _LISTENERS:
            listener.notice(notice)


def forget_reports() -> None:
    """Begin a command line, which reports its notices again, to no listener yet."""
    _REPORTED.clear()
    _LISTENERS.clear()


@functools.cache
def terminal() -> Console:
    """Return the console that shows progress on a terminal."""
    from rich.console import Console

    return Console(file=STDERR, highlight=False, emoji=False)


@contextmanager
def busy(what: str) -> Iterator[None]:
    """Show a moving bar on a terminal, below the one that is shown, while work has no measure."""
    if not STDERR.isatty():
        yield
    elif (bar := Stages.bar) is not None:
        task = bar.add_task(what, total=None)
        try:
            yield
        finally:
            bar.remove_task(task)
    else:
        with _progress(what):
            yield


@contextmanager
def _progress(what: str) -> Iterator[Advance]:
    """Show a bar on a terminal, or a line from time to time; yields ``advance(done, total)``."""
    if not STDERR.isatty():
        yield _Lines(what)
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description:<24}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=terminal(), transient=True) as bar:
        task = bar.add_task(printable(what), total=None)
        Stages.bar = bar
        try:
            yield lambda done, total: bar.update(task, completed=done, total=total)
        finally:
            Stages.bar = None


def shown(what: str, items: Sequence[T]) -> Iterator[T]:
    """Yield items and show how many of them are done."""
    with Stages() as progress:
        progress(what, 0, len(items))
        for done, item in enumerate(items, 1):
            yield item
            progress(what, done, len(items))


class Stages:
    """Show the stages of a library call one after another, each with its own progress bar.

    A context manager; inside the ``with`` block it is a `rig.Progress`. A terminal has room for
    one bar: while one is shown, the stages of others are not.
    """

    _shown: ClassVar[Stages | None] = None
    # The display of the bar that is shown, on a terminal.
    bar: ClassVar[Progress | None] = None

    def __init__(self) -> None:
        self._open = ExitStack()
        self._stage: str | None = None
        self._advance: Advance | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the stage that is shown."""
        self._open.close()
        if Stages._shown is self:
            Stages._shown = None

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """Report on a stage; a new name ends the stage before it."""
        Stages._shown = Stages._shown or self
        if Stages._shown is not self:
            return
        if self._advance is None or stage != self._stage:
            self._open.close()
            self._advance = self._open.enter_context(_progress(stage))
            self._stage = stage
        self._advance(done, total)
        for listener in _LISTENERS:
            listener.progress(stage, done, total)


def with_progress(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function of a room that shows its stages, which it reports to ``on_progress``."""

    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        with Stages() as progress:
            kwargs["on_progress"] = progress
            return function(*args, **kwargs)

    return call


class _Lines:
    """Progress as log lines; short work prints none."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._began_s = self._printed_s = time.monotonic()
        self._first: int | None = None

    def __call__(self, done: int, total: int) -> None:
        now_s = time.monotonic()
        if self._first is None:  # work that continues begins with what was done before
            self._first = done
        if now_s - self._printed_s < _LINE_EVERY_S or not self._first < done < total:
            return
        left_s = (now_s - self._began_s) * (total - done) / (done - self._first)
        note(f"{self._what}: {done / total:.0%} done, about {left_s:.0f} s left")
        self._printed_s = now_s


_TEXT = "compiling kernels for this computer, once; this can take some minutes"


class Compiling(KernelWatch):
    """Reports on stderr that kernels are compiled, or that they cannot be kept."""

    def __init__(self) -> None:
        self._stated = False
        self._bar = ExitStack()

    def compiling(self, active: int) -> None:
        """Show a bar while a kernel is compiled, and a line at the first."""
        if active and not self._stated:
            self._stated = True
            note(_TEXT)
        if active == 0:
            self._bar.close()
        elif active == 1:
            self._bar.enter_context(busy("compiling kernels"))

    def uncached(self, reason: str) -> None:
        """State that kernels cannot be kept, which also says that they are compiled."""
        self._stated = True
        note(f"note: {reason}")
