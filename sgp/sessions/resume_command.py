"""The command that resumes a session, in a form that a shell understands."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import acquisition


@dataclass(frozen=True)
class ResumeCommand:
    """The command line that takes the missing shots of a session.

    Parameters
    ----------
    session
        Folder of the session.
    rig
        Name of the rig or path of its file; None if it is not known.
    skip_check
        Whether the recording skipped the checks.
    """

    session: Path
    rig: str | None = None
    skip_check: bool = False

    def text(self, *, retake_damaged: bool = False) -> str:
        """Return the command line, quoted, with all options that it needs."""
        words = [*_capture(), "resume", str(self.session)]
        words += [] if self.rig is None else ["--rig", self.rig]
        words += ["--skip-check"] * self.skip_check
        words += ["--retake-damaged"] * retake_damaged
        return subprocess.list2cmdline(words) if sys.platform == "win32" else shlex.join(words)


def can_be_retaken(session: Path) -> bool:
    """Return whether damaged frames are the only fault and were recorded with a rig."""
    with suppress(acquisition.DataError):
        return acquisition.Session.open(session, damaged_frames=True).manifest.rig is not None
    return False


def _capture() -> list[str]:
    """Return the words with which `capture` can be started as this program was."""
    program = Path(sys.argv[0])
    if program.parts[-2:] == ("sgp", "__main__.py"):
        return [sys.executable, "-m", "sgp", "capture"]
    if program.stem not in ("sgp", "capture") or _is_on_path(program):
        return ["capture"]
    return [str(program), *["capture"] * (program.stem == "sgp")]


def _is_on_path(program: Path) -> bool:
    found = shutil.which(program.stem)
    try:
        return found is not None and os.path.samefile(found, program)
    except OSError:
        return False
