"""Damage of one frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from acquisition._session.session_frame import SessionFrame
from rig import Notice, short_repr


@dataclass(frozen=True, eq=False)
class Damage:
    """A frame that differs from its recording, or that contradicts the journal.

    Parameters
    ----------
    frame
        The frame.
    reason
        Description of the damage, as the end of a sentence that begins with ``where``.
    where
        The damaged file: the frame's file or the journal.
    """

    frame: SessionFrame
    reason: str
    where: Path

    __repr__ = short_repr

    @property
    def notice(self) -> Notice:
        """The damage as a notice: the file, the damage, and what to do."""
        in_file = self.where == self.frame.path
        remedy = "restore the file or retake the shot" if in_file else "retake the shot"
        return Notice("frame-damaged", f"{self.reason}; {remedy}", str(self.where), "error")

    @property
    def text(self) -> str:
        """One line with the file, the damage, and what to do."""
        return str(self.notice)
