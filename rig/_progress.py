"""How long-running functions report their progress."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Receives the progress of a long-running function. An exception it raises ends the work."""

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """Report that ``done`` of ``total`` steps of a stage are finished.

        Parameters
        ----------
        stage
            Name of the stage for the waiting user, such as ``reading``.
        done, total
            Steps of this stage. ``total`` may grow while the stage runs.
        """
        ...


def no_progress(stage: str, done: int, total: int, /) -> None:
    """Report nothing; the default of functions that take a `Progress`."""
