"""``capture``: record sessions and look after them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from acquisition import (
    CapturePlan,
    DataError,
    MeteringGoal,
    PlannedShot,
    Session,
    check_resume,
    preflight,
    read_camera,
    read_lights,
    read_plan,
    record,
    rehearse,
    verify_session,
)
from acquisition import meter as meter_plan
from acquisition import resume as resume_recording
from rig import Rig, RigError, open_rig
from sgp._capture_talk import CaptureTalk
from sgp._console import note, progress
from sgp._output import check_file, check_folder
from sgp._result import Result
from sgp._session_sheet import write_session_sheet
from sgp._session_summary import describe
from sgp.commands.capture_plan import chosen_plan

Metering = Literal["each", "one"]


def run(
    out: Path,
    *,
    rig: str = "simulated",
    plan: Path | None = None,
    meter: Metering | None = None,
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

        capture run recordings/owl --rig bench.toml --plan plan.toml --object-name owl

    Parameters
    ----------
    out
        New folder for the session. Nothing is ever recorded over a session.
    rig
        Name of a rig, or a rig.toml.
    plan
        Plan file; default: every working LED once at 20 ms, and a dark frame.
    meter
        Choose the exposures on the spot instead: each LED its own, or one for all.
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
    stored_lights = None if lights is None else read_lights(lights)
    with open_rig(rig) as opened:
        model = None if camera is None else read_camera(camera, _upright_size(opened))
        chosen, left_out = chosen_plan(plan, opened.config)
        if dry_run:
            return _rehearse(opened, chosen, chosen.shots())
        events: list[tuple[str, dict[str, Any]]] = []
        warnings: list[str] = []
        if left_out:
            events.append(("left_out", {"leds": list(left_out), "reason": "listed as dead"}))
            warnings.append(f"LED {', '.join(map(str, left_out))}: listed as dead, left out")
        if meter is not None:
            chosen = _metered(opened, chosen, meter, events, warnings)
        if not skip_check:
            _check(opened, chosen, out, events, warnings)
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
                events=events,
                on_frame=talk.on_frame,
                on_event=talk.on_event,
                on_stop=talk.on_stop,
                before_flats=talk.before_flats,
            )
    return describe(session, warnings)


def resume(
    session: Path, *, rig: str = "simulated", plan: Path | None = None, dry_run: bool = False
) -> Result:
    """Take the shots that a session is missing.

    The rig must be the one that the session was begun with: same board, same camera, same plan.

    For example:

        capture resume recordings/owl --rig bench.toml

    Parameters
    ----------
    session
        The session's folder.
    rig
        Name of a rig, or a rig.toml.
    plan
        Plan file; if given, a session of another plan is refused.
    dry_run
        Check that it can be done, take the missing shots with all LEDs off and record nothing.
    """
    asked = None if plan is None else read_plan(plan)
    missing = Session.open(session).missing
    only_flats = bool(missing) and all(shot.role == "flat" for shot in missing)
    with open_rig(rig) as opened:
        if dry_run:
            found, recorded = check_resume(opened, session, asked)
            return _rehearse(opened, recorded, found.missing)
        with CaptureTalk(session, card_is_there=only_flats) as talk:
            finished = resume_recording(
                opened,
                session,
                plan=asked,
                on_frame=talk.on_frame,
                on_event=talk.on_event,
                on_stop=talk.on_stop,
                before_flats=talk.before_flats,
            )
    return describe(finished, [f"{len(missing)} shots were missing and have been taken"])


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
        },
        warnings=list(found.warnings),
        summary=list(found.problems),
        ok=found.ok and found.complete,
    )
    if found.problems:
        result.summary.append(f"{session}: DAMAGED, {len(found.problems)} problems")
    elif not found.complete:
        missing = f", first missing {found.missing[0]}" if found.missing else ""
        result.summary.append(
            f"{session}: incomplete, {found.frames} frames are whole, "
            f"{len(found.missing)} are missing{missing}"
        )
    else:
        result.summary.append(
            f"{session}: whole and complete, {found.frames} frames, {found.bytes / 1e6:.1f} MB"
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
    result = describe(opened, [lost] if lost else [])
    if sheet is not None:
        check_file(sheet, ".png", force=force)
        if not opened.frames:
            raise DataError(f"{session}: no frame counts, there is nothing to draw")
        write_session_sheet(sheet, opened)
        result.outputs["sheet"] = sheet
    return result


def _upright_size(rig: Rig) -> tuple[int, int]:
    info = rig.camera.info
    height, width = rig.config.mounting.upright_shape((info.height, info.width))
    return height, width


def _metered(
    rig: Rig,
    plan: CapturePlan,
    how: Metering,
    events: list[tuple[str, dict[str, Any]]],
    warnings: list[str],
) -> CapturePlan:
    with progress("metering") as advance:
        found = meter_plan(
            rig,
            plan,
            MeteringGoal(each=how == "each"),
            on_light=lambda light, done, total: advance(done, total),
        )
    events.append(("metered", found.details()))
    if found.dead_leds:
        reason = "gave no light when metered"
        events.append(("left_out", {"leds": list(found.dead_leds), "reason": reason}))
    warnings += found.warnings
    return found.plan


def _check(
    rig: Rig,
    plan: CapturePlan,
    out: Path,
    events: list[tuple[str, dict[str, Any]]],
    warnings: list[str],
) -> None:
    """Do the pre-flight; refuse to go on where it fails."""
    note("checking disk, rig and picture (--skip-check leaves this out)")
    found = preflight(rig, plan, out)
    if not found.ok:
        complaints = "; ".join(f"{check.name}: {check.text}" for check in found.failed)
        raise RigError(f"the check before recording failed: {complaints}")
    events.append(("checked", found.details()))
    warnings += [
        f"{check.name}: {check.text}" for check in found.checks if check.state == "warning"
    ]


def _rehearse(rig: Rig, plan: CapturePlan, shots: Sequence[PlannedShot]) -> Result:
    with progress("dry run") as advance:
        seconds = rehearse(rig, plan, advance, shots=shots)
    count, info = len(shots), rig.camera.info
    size = count * info.width * info.height * 2
    return Result(
        metrics={"shots": count, "seconds": seconds, "bytes": size, "recorded": False},
        summary=[
            f"dry run: {count} shots in {seconds:.1f} s with all LEDs off, nothing was recorded; "
            f"they would take {size / 1e6:.0f} MB"
        ],
    )
