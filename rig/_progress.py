"""How long work reports where it stands."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Receives the progress of long work. What it raises ends the work."""

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """Report that ``done`` of ``total`` steps of a stage are finished.

        Parameters
        ----------
        stage
            What is being done, such as ``reading``, in the words of the person who waits.
        done, total
            Steps of this stage. ``total`` may grow while the stage runs.
        """
        ...


def silent(stage: str, done: int, total: int, /) -> None:
    """Report nothing: the default of functions that take a `Progress`."""
