"""``capture``: record sessions and look after them."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from acquisition import (
    Damage,
    DataError,
    Session,
    check_resume,
    damaged_frames,
    preflight,
    preflight_resume,
    read_camera,
    read_lights,
    read_plan,
    record,
    verify_session,
)
from acquisition import resume as resume_recording
from rig import Rig, open_rig
from sgp._capture.session_sheet import write_session_sheet
from sgp._capture.session_summary import describe
from sgp._capture.steps import MeterOptions, Told, accept, metered
from sgp._capture.steps import dry_run as rehearsed
from sgp._capture.talk import CaptureTalk
from sgp._console import Stages, note
from sgp._output import check_file, check_folder
from sgp._result import Result
from sgp.commands.capture_plan import chosen_plan

_UNMETERED = MeterOptions()


def run(
    out: Path,
    *,
    rig: str = "simulated",
    plan: Path | None = None,
    metering: MeterOptions = _UNMETERED,
    object_name: str = "",
    operator: str = "",
    place: str = "",
    notes: str = "",
    rights: str = "",
    camera: Path | None = None,
    lights: Path | None = None,
    skip_check: bool = False,
    dry_run: bool = False,
) -> Result:
    """Record a session on a rig.

    Frames are hashed, stored and journalled while the next ones are taken. Ctrl-C once ends the
    work after this shot, twice at once; either way the LEDs are off, and `capture resume` finishes
    what is missing.

    For example:

        capture run recordings/owl --rig bench.toml --plan plan.toml

    Parameters
    ----------
    out
        New folder for the session. Nothing is ever recorded over a session.
    rig
        Name of a rig, or a rig.toml.
    plan
        Plan file; default: every working LED once at 20 ms, and a dark frame.
    metering
        How exposures are chosen on the spot.
    object_name
        What is recorded.
    operator
        Who records it.
    place
        Where.
    notes
        Anything worth knowing later.
    rights
        Who holds the rights, and the licence.
    camera
        Camera model to store with the session.
    lights
        Calibrated lights to store with the session.
    skip_check
        Leave out the checks of disk, rig and picture that come first.
    dry_run
        Take every shot with all LEDs off and record nothing.
    """
    check_folder(out)
    goal = metering.goal()
    stored_lights = None if lights is None else read_lights(lights)
    with open_rig(rig) as opened:
        model = None if camera is None else read_camera(camera, _upright_size(opened))
        chosen, left_out = chosen_plan(plan, opened.config)
        if dry_run:
            return rehearsed(opened, chosen, chosen.shots())
        told = Told()
        if left_out:
            told.events.append(("left_out", {"leds": list(left_out), "reason": "listed as dead"}))
            told.warnings.append(f"LED {', '.join(map(str, left_out))}: listed as dead, left out")
        if goal is not None:
            chosen = metered(opened, chosen, goal, told)
        if not skip_check:
            note("checking disk, rig and picture (--skip-check leaves this out)")
            accept(preflight(opened, chosen, out), told)
        for warning in told.warnings:
            note(f"note: {warning}")
        with CaptureTalk(out) as talk:
            session = record(
                opened,
                chosen,
                out,
                operator=operator,
                object_name=object_name,
                place=place,
                notes=notes,
                rights=rights,
                camera_model=model,
                lights=stored_lights,
                events=told.events,
                on_progress=talk.on_progress,
                on_event=talk.on_event,
                on_stop=talk.on_stop,
                before_flats=talk.before_flats,
            )
    return describe(session, told.warnings)


def resume(
    session: Path,
    *,
    rig: str = "simulated",
    plan: Path | None = None,
    retake_damaged: Annotated[bool, Parameter(negative=())] = False,
    skip_check: bool = False,
    dry_run: bool = False,
) -> Result:
    """Take the shots that a session is missing.

    The rig must be the one that the session was begun with: same board, same camera, same plan.
    LEDs that died since are listed in dead_leds of the rig file: the session becomes complete
    without what they are missing. Frames recorded before are read back meanwhile: a session with a
    damaged frame does not become complete.

    For example:

        capture resume recordings/owl --rig bench.toml
        capture resume recordings/owl --rig bench.toml --retake-damaged

    Parameters
    ----------
    session
        The session's folder.
    rig
        Name of a rig, or a rig.toml.
    plan
        Plan file; if given, a session of another plan is refused.
    retake_damaged
        Take the shots of damaged and lost frames again, of a complete session too. The object must
        lie as it did; the damaged files are kept in derived/set_aside.
    skip_check
        Leave out the checks of disk and rig that come first.
    dry_run
        Check that it can be done, take the missing shots with all LEDs off and record nothing.
    """
    asked = None if plan is None else read_plan(plan)
    # What is no session is refused before the rig is opened.
    begun = _opened(session, retake_damaged=retake_damaged)
    damaged = _damaged(session) if retake_damaged else None
    if begun.complete and asked is None and not damaged:
        nothing = "nothing was missing" if damaged is None else "no frame is damaged"
        return describe(begun, [*begun.warnings, f"complete already: {nothing}"])
    with open_rig(rig) as opened:
        _, recorded, missing = check_resume(opened, session, asked, damaged=damaged)
        if dry_run:
            return rehearsed(opened, recorded, missing)
        if begun.lost_lines:
            note(f"note: {begun.lost_lines}")
        told = Told()
        if not skip_check:
            alive, _ = recorded.without(opened.config.dead_leds)
            accept(preflight_resume(opened, alive, session, len(missing)), told)
        # Who goes on where flats are missing has put the card there; not so for damaged flats.
        only_flats = bool(missing) and all(shot.role == "flat" for shot in missing) and not damaged
        with CaptureTalk(session, card_is_there=only_flats) as talk:
            finished = resume_recording(
                opened,
                session,
                plan=asked,
                events=told.events,
                retake_damaged=retake_damaged,
                on_progress=talk.on_progress,
                on_event=talk.on_event,
                on_stop=talk.on_stop,
                on_damage=talk.on_damage,
                before_flats=talk.before_flats,
            )
    taken = [f"shots that were missing and have been taken: {len(missing)}"]
    return describe(finished, [*begun.warnings, *taken, *_left_out(finished), *told.warnings])


def verify(session: Path) -> Result:
    """Check every hash of a session and name what is damaged or missing.

    For example:

        capture verify recordings/owl

    Parameters
    ----------
    session
        The session's folder.
    """
    found = verify_session(session)
    result = Result(
        metrics={
            "whole": found.ok,
            "complete": found.complete,
            "frames": found.frames,
            "events": found.events,
            "bytes": found.bytes,
            "problems": list(found.problems),
            "missing": list(found.missing),
            "left_out": list(found.left_out),
            "damaged": list(found.damaged),
            "set_aside": list(found.set_aside),
        },
        warnings=list(found.warnings),
        summary=list(found.problems),
        ok=found.ok and found.complete,
    )
    if found.problems:
        several = "s" if len(found.problems) > 1 else ""
        result.summary.append(f"{session}: DAMAGED, {len(found.problems)} problem{several}")
        if len(found.damaged) == len(found.problems) and _can_be_retaken(session):
            result.summary.append(
                f"while the object lies as it did, `capture resume {session} --retake-damaged` "
                "takes these frames again"
            )
    elif not found.complete:
        missing = "but it was not brought to its end"
        if found.missing:
            missing = f"{len(found.missing)} are missing, first {found.missing[0]}"
        result.summary.append(f"{session}: incomplete, {found.frames} frames are whole, {missing}")
    else:
        result.summary.append(
            f"{session}: whole and complete, {found.frames} frames, {found.bytes / 1e6:.1f} MB"
        )
        if found.left_out:
            result.summary.append(
                f"{len(found.left_out)} planned frames were left out as their LED died, first "
                f"{found.left_out[0]}"
            )
    return result


def info(session: Path, *, sheet: Path | None = None, force: bool = False) -> Result:
    """Tell what a session holds.

    For example:

        capture info recordings/owl --sheet owl.png

    Parameters
    ----------
    session
        The session's folder.
    sheet
        Contact sheet to write, a .png.
    force
        Replace a contact sheet that exists.
    """
    opened = Session.open(session)
    gone = [frame.path.name for frame in opened.frames if not frame.path.is_file()]
    lost = f"{len(gone)} frame files are not there, first {gone[0]}: see verify" if gone else ""
    result = describe(opened, [*([lost] if lost else []), *_left_out(opened)])
    if sheet is not None:
        check_file(sheet, ".png", force=force)
        if not opened.frames:
            raise DataError(f"{session}: no frame counts, there is nothing to draw")
        write_session_sheet(sheet, opened)
        result.outputs["sheet"] = sheet
    return result


def _opened(session: Path, *, retake_damaged: bool) -> Session:
    """Open a session to go on with; where single frames are damaged, an error says what helps."""
    try:
        return Session.open(session, damaged_frames=retake_damaged)
    except DataError as error:
        if not retake_damaged and _can_be_retaken(session):
            error.add_note(f"`capture resume {session} --retake-damaged` takes it again")
        raise


def _can_be_retaken(session: Path) -> bool:
    """Tell whether damaged frames are all that is wrong, and a rig took them."""
    with suppress(DataError):
        return Session.open(session, damaged_frames=True).manifest.rig is not None
    return False


def _damaged(session: Path) -> tuple[Damage, ...]:
    """Read every frame back, and tell of those that are damaged."""
    with Stages() as progress:
        found = damaged_frames(session, on_progress=progress)
    for damage in found:
        note(f"damaged: {damage.text}")
    return found


def _upright_size(rig: Rig) -> tuple[int, int]:
    info = rig.camera.info
    height, width = rig.config.mounting.upright_shape((info.height, info.width))
    return height, width


def _left_out(session: Session) -> list[str]:
    """Tell of shots that are not demanded, as their LED died while recording."""
    leds = dict.fromkeys(str(shot.lit_led) for shot in session.left_out)
    if not leds:
        return []
    return [f"LED {', '.join(leds)}: died, shots left out: {len(session.left_out)}"]
