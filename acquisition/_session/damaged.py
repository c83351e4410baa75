"""Damaged frames of a session."""

from __future__ import annotations

from pathlib import Path

from acquisition._session.damage import Damage
from acquisition._session.frame_proofs import FrameProofs
from acquisition._session.session import Examination, examine
from rig import Progress, no_progress


def damaged_frames(
    folder: str | Path, *, on_progress: Progress = no_progress
) -> tuple[Damage, ...]:
    """Read back every frame of a session and return the damaged ones; nothing is changed.

    Parameters
    ----------
    folder
        The session, complete or not.
    on_progress
        Receives the stage ``checking recorded frames``, one step per frame.

    Returns
    -------
    tuple of Damage
        Frames that are lost, changed, or contradicted by their own or by other lines, in order of
        recording. `resume` can set them aside and take their shots again.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If it is not a session, or has damage other than single frames.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import damaged_frames, import_frames, read_source, write_png
    >>> write_png("card.png", np.full((4, 5), 700, np.uint16))
    >>> session = import_frames(read_source("card.png"), "session")
    >>> session.frames[0].path.unlink()
    >>> [damage.frame for damage in damaged_frames("session")]
    [SessionFrame(L00_E0.tif, light, LED 0, shape (4, 5))]
    """
    examination = examine(Path(folder))
    session = examination.sound(but_for_frames=True)
    proofs = FrameProofs(session.manifest.camera, session.recorded)
    return damaged_frames_of(examination, proofs, on_progress)


def damaged_frames_of(
    examination: Examination, proofs: FrameProofs, on_progress: Progress
) -> tuple[Damage, ...]:
    """Return the damaged frames of an examined session."""
    by_seq = {one.frame.line.seq: one for one in proofs.check_all(on_progress)}
    by_seq |= dict(examination.flaws)
    return tuple(by_seq[seq] for seq in sorted(by_seq))
