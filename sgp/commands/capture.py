"""Record, check, import and export sessions.

For example:

    capture plan plan.toml --rig bench.toml
    capture run recordings/owl --rig bench.toml --plan plan.toml
    capture verify recordings/owl
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import acquisition
import rig as rigs
from sgp.cli.console import note, with_progress
from sgp.cli.options import Input, OptionalInput, RigOption
from sgp.commands.capture_plan import chosen_plan
from sgp.results import Result, check_folder
from sgp.rigs import chosen_rig
from sgp.sessions import (
    Acceptance,
    Accepted,
    Events,
    EventStream,
    MeterOptions,
    Order,
    ResumeCommand,
    StoredOptions,
    can_be_retaken,
    describe,
    judge_frames,
    record_on_rig,
    resume_on_rig,
)
from sgp.sessions import dry_run as rehearsed

_UNMETERED = MeterOptions()
_STORED = StoredOptions()


def run(
    out: Path,
    *,
    rig: RigOption = None,
    plan: OptionalInput = None,
    metering: MeterOptions = _UNMETERED,
    object_name: str = "",
    notes: str = "",
    stored: StoredOptions = _STORED,
    skip_check: bool = False,
    accept: Accepted = (),
    dry_run: bool = False,
    events: Events = False,
) -> Result:
    """Record a session on a rig.

    Frames are hashed, stored and written to the journal while the next ones are taken. Ctrl-C once:
    finish this shot; twice: stop immediately. Both turn the LEDs off, and `capture resume` takes
    the missing shots. The last line is a verdict about the frames: good, check, or do not use.

    For example:

        capture run recordings/owl --rig bench.toml --plan plan.toml

    Parameters
    ----------
    out
        New folder for the session. An existing session is never overwritten.
    rig
        Name of a rig, or path of a rig file (.toml); default: the environment variable SGP_RIG, or
        else `rig` in the configuration file (~/.config/sgp/config.toml on Linux).
    plan
        Plan file; default: each working LED once at 20 ms, and a dark frame.
    metering
        How exposure times are metered.
    object_name
        Name of the object.
    notes
        Free text.
    stored
        What the session stores besides the frames.
    skip_check
        Skip the checks of disk, rig and picture before the recording.
    accept
        Code of a finding that makes a recording useless, to record anyway; can be repeated. On a
        terminal the command asks instead.
    dry_run
        Take every shot with all LEDs off and record nothing.
    events
        Print one JSON line per event to stdout, and ask nothing.
    """
    accepting = Acceptance(accept, EventStream() if events else None)
    rig_name = chosen_rig(rig)
    check_folder(out)
    goal, order = metering.goal(), Order.read(rig_name, rig, stored)
    with rigs.open_rig(rig_name) as opened:
        chosen, left_out = chosen_plan(plan, opened.config)
        if dry_run:
            order.calibrations(opened)
            return rehearsed(opened, chosen, chosen.shots())
        return record_on_rig(
            opened,
            chosen,
            left_out,
            out,
            order,
            order.labels(object_name, notes),
            goal=goal,
            skip_check=skip_check,
            accepting=accepting,
        )


def resume(
    session: Input,
    *,
    rig: RigOption = None,
    plan: OptionalInput = None,
    retake_damaged: Annotated[bool, Parameter(negative=())] = False,
    skip_check: bool = False,
    accept: Accepted = (),
    dry_run: bool = False,
    events: Events = False,
) -> Result:
    """Take the missing shots of a session.

    Board, camera and plan must be the same as at the start of the session. List LEDs that died
    since in dead_leds of the rig file: the session can then become complete without their shots.
    The frames recorded before are verified at the same time: a session with a damaged frame does
    not become complete. First, the last light is taken again: if another object is under the
    camera, or it moved, nothing is changed.

    For example:

        capture resume recordings/owl --rig bench.toml
        capture resume recordings/owl --rig bench.toml --retake-damaged

    Parameters
    ----------
    session
        Folder of the session.
    rig
        Name of a rig, or path of a rig file (.toml); default: the environment variable SGP_RIG, or
        else `rig` in the configuration file (~/.config/sgp/config.toml on Linux).
    plan
        Plan file; if given, a session with another plan is refused.
    retake_damaged
        Take the shots of damaged and lost frames again, also in a complete session. The object must
        not have moved. The damaged files are kept in derived/set_aside.
    skip_check
        Skip the checks of disk and rig before the recording.
    accept
        Code of a finding that makes further frames useless, to continue anyway; can be repeated.
        On a terminal the command asks instead.
    dry_run
        Check that the session can be resumed, take the missing shots with all LEDs off and record
        nothing.
    events
        Print one JSON line per event to stdout, and ask nothing.
    """
    accepting = Acceptance(accept, EventStream() if events else None)
    rig_name = chosen_rig(rig)
    asked = None if plan is None else acquisition.read_plan(plan)
    again = ResumeCommand(session, rig_name, skip_check)
    # A folder that is not a session is refused before the rig is opened.
    begun = _opened(again, retake_damaged=retake_damaged)
    damaged = _damaged(session) if retake_damaged else None
    if begun.complete and not damaged:
        _check_plan(begun, asked)
        nothing = "no shot is missing" if damaged is None else "no frame is damaged"
        done = rigs.Notice("already-complete", f"already complete: {nothing}", severity="info")
        return judge_frames(describe(begun, [*begun.warnings, done]), begun)
    with rigs.open_rig(rig_name) as opened:
        if dry_run:
            _, recorded, missing = acquisition.engine.check_resume(
                opened, session, asked, damaged=damaged
            )
            return rehearsed(opened, recorded, missing)
        return resume_on_rig(
            opened, begun, again, asked=asked, damaged=damaged, accepting=accepting
        )


def _opened(again: ResumeCommand, *, retake_damaged: bool) -> acquisition.Session:
    """Open a session to resume it; if frames are damaged, the error names the command to use."""
    try:
        return acquisition.Session.open(again.session, damaged_frames=retake_damaged)
    except acquisition.DataError as error:
        if not retake_damaged and can_be_retaken(again.session):
            error.add_note(f"`{again.text(retake_damaged=True)}` takes it again")
        raise


def _check_plan(session: acquisition.Session, asked: acquisition.CapturePlan | None) -> None:
    """Refuse another plan than that of a complete session, for which no rig is opened."""
    manifest = session.manifest
    if asked is not None and manifest.planned(asked) != manifest.plan:
        raise acquisition.DataError(
            f"{session.folder}: is complete, and was recorded with another plan: use the original "
            "plan, or record into a new folder"
        )


def _damaged(session: Path) -> tuple[acquisition.session.Damage, ...]:
    """Verify every frame, and report those that are damaged."""
    damages = with_progress(acquisition.session.damaged_frames)(session)
    for damage in damages:
        note(f"damaged: {damage.text}")
    return damages
