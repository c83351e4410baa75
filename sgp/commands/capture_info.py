"""``capture verify`` and ``capture info``: verify and describe recorded sessions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import acquisition
import rig as rigs
from sgp.cli.exit import UsageError
from sgp.cli.options import Input
from sgp.results import Result, check_file
from sgp.rigs import default_rig
from sgp.sessions import ResumeCommand, can_be_retaken, describe, left_out_notices

# Of a verification, besides whether the session is whole.
_FIGURES = (
    *("complete", "frames", "events", "bytes"),
    *("problems", "missing", "left_out", "damaged", "set_aside"),
)


def verify(session: Input) -> Result:
    """Verify all hashes of a session and list damaged and missing frames.

    For example:

        capture verify recordings/owl

    Parameters
    ----------
    session
        Folder of the session.
    """
    checked = acquisition.verify_session(session)
    result = Result(
        metrics={"whole": checked.ok, **{name: getattr(checked, name) for name in _FIGURES}},
        warnings=list(checked.warnings),
        summary=list(checked.problems),
        ok=checked.ok and checked.complete,
    )
    if checked.problems:
        problems = rigs.pluralize(len(checked.problems), "problem")
        result.summary.append(f"{session}: DAMAGED, {problems}")
        if len(checked.damaged) == len(checked.problems) and can_be_retaken(session):
            again = ResumeCommand(session).text(retake_damaged=True)
            rig = "" if _has_default_rig() else ", with --rig,"
            result.summary.append(
                f"if the object has not moved, `{again}`{rig} takes these frames again"
            )
    elif not checked.complete:
        missing = "but the session was not finished"
        if checked.missing:
            are = rigs.pluralize(len(checked.missing), "is", "are")
            missing = f"{are} missing, first {checked.missing[0]}"
        intact = rigs.pluralize(checked.frames, "frame is", "frames are")
        result.summary.append(f"{session}: incomplete, {intact} intact, {missing}")
    else:
        result.summary.append(
            f"{session}: intact and complete, {rigs.pluralize(checked.frames, 'frame')}, "
            f"{checked.bytes / 1e6:.1f} MB"
        )
        if checked.left_out:
            words = ("planned frame was", "planned frames were")
            skipped = rigs.pluralize(len(checked.left_out), *words)
            result.summary.append(
                f"{skipped} skipped because their LED died, first {checked.left_out[0]}"
                if len(checked.left_out) > 1
                else f"{skipped} skipped because its LED died: {checked.left_out[0]}"
            )
    return result


def info(
    session: Input,
    *,
    frames: Annotated[bool, Parameter(negative=())] = False,
    sheet: Path | None = None,
    force: bool = False,
) -> Result:
    """Describe the contents of a session.

    For example:

        capture info recordings/owl --sheet owl.png

    Parameters
    ----------
    session
        Folder of the session.
    frames
        List every frame.
    sheet
        Contact sheet to write (.png).
    force
        Overwrite an existing contact sheet.
    """
    opened = acquisition.Session.open(session)
    gone = [frame.path.name for frame in opened.frames if not frame.path.is_file()]
    lost = []
    if gone:
        files = rigs.pluralize(len(gone), "frame file is", "frame files are")
        text = f"{files} missing, first {gone[0]}: see verify"
        lost.append(rigs.Notice("frame-files-missing", text, severity="error"))
    result = describe(opened, [*lost, *left_out_notices(opened)], frames=frames)
    if sheet is not None:
        check_file(sheet, ".png", force=force)
        if not opened.frames:
            raise acquisition.DataError(
                f"{session}: no frames to draw: all are rejected or missing"
            )
        from sgp.sessions import write_session_sheet

        write_session_sheet(sheet, opened)
        result.outputs["sheet"] = sheet
    return result


def _has_default_rig() -> bool:
    try:
        return default_rig() is not None
    except UsageError:
        return False  # an invalid configuration must not hide the result of a check
