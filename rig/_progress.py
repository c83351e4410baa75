"""Progress reports of long operations."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Callback that receives the progress of a long operation. An error it raises ends it."""

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """Report that ``done`` of ``total`` steps of a stage are finished.

        Parameters
        ----------
        stage
            Name of the stage for the user, for instance ``reading``.
        done, total
            Numbers of steps of this stage. ``total`` may grow while the stage runs.
        """
        ...


def no_progress(stage: str, done: int, total: int, /) -> None:
    """Report nothing; the default of functions that take a `Progress`.

    Examples
    --------
    >>> from rig import no_progress
    >>> no_progress("reading", 3, 12)
    """
