"""What is wrong with one frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from acquisition._session.session_frame import SessionFrame


@dataclass(frozen=True, eq=False)
class Damage:
    """A frame that is not as it was recorded, or that the journal contradicts.

    Parameters
    ----------
    frame
        The frame.
    reason
        What is wrong, as the end of a sentence that begins with ``where``.
    where
        The file that shows it, of the frame or the journal.
    """

    frame: SessionFrame
    reason: str
    where: Path

    @property
    def text(self) -> str:
        """One line: where, what, and what to do."""
        in_file = self.where == self.frame.path
        remedy = "restore the file or retake the shot" if in_file else "retake the shot"
        return f"{self.where}: {self.reason}; {remedy}"
