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
from sgp.cli.console import note, report, with_progress
from sgp.cli.options import Input, OptionalInput, OptionalLights, RigOption
from sgp.commands.capture_plan import chosen_plan
from sgp.results import Result, check_folder
from sgp.rigs import chosen_operator, chosen_rig, given_lights
from sgp.sessions import (
    Acceptance,
    Accepted,
    CaptureTalk,
    Events,
    EventStream,
    MeterOptions,
    Preparation,
    ResumeCommand,
    can_be_retaken,
    checked_wiring,
    describe,
    judge_frames,
    left_out_notices,
    metered,
    take_findings,
)
from sgp.sessions import dry_run as rehearsed

_UNMETERED = MeterOptions()


def run(
    out: Path,
    *,
    rig: RigOption = None,
    plan: OptionalInput = None,
    metering: MeterOptions = _UNMETERED,
    object_name: str = "",
    operator: str | None = None,
    place: str = "",
    notes: str = "",
    rights: str = "",
    camera: OptionalInput = None,
    lights: OptionalLights = None,
    sensor: OptionalInput = None,
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
    operator
        Name of the operator; default: `operator` in the configuration file.
    place
        Place of the recording.
    notes
        Free text.
    rights
        Holder of the rights, and the licence.
    camera
        Camera file to store with the session.
    lights
        Lights to store with the session: a file of calibrated lights, or rig for the LEDs at
        led_positions_mm of the rig file.
    sensor
        sensor.json of `sgp calibrate sensor` to store with the session: noise, black level and
        white level; default: that of the rig file, if it names one.
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
    stream = EventStream() if events else None
    rig_name, operator_name = chosen_rig(rig), chosen_operator(operator)
    check_folder(out)
    goal, accepting = metering.goal(), Acceptance(accept, stream)
    given = None if lights is None else given_lights(lights, option=rig)
    measured = _measured_sensor(sensor, rig_name)
    with rigs.open_rig(rig_name) as opened:
        model = None if camera is None else acquisition.read_camera(camera, _upright_size(opened))
        chosen, left_out = chosen_plan(plan, opened.config)
        if dry_run:
            return rehearsed(opened, chosen, chosen.shots())
        prepared = Preparation()
        prepared.warnings += () if given is None else given.lights.warnings
        if left_out:
            dead = {"leds": list(left_out), "reason": "listed as dead"}
            prepared.events.append(("left_out", dead))
            text = f"LED {', '.join(map(str, left_out))} skipped: listed in dead_leds"
            prepared.warnings.append(rigs.Notice("leds-skipped", text, severity="info"))
        if measured is not None:
            prepared.warnings += acquisition.source.sensor_notices(
                measured, _setup(opened), chosen.gain_db
            )
        tested: bool | acquisition.preflights.Check = True
        if goal is not None:
            if not skip_check:  # metering swapped LEDs would waste minutes
                note("checking the wiring of the LEDs (--skip-check skips this)")
                tested = checked_wiring(opened, chosen)
            chosen = metered(opened, chosen, goal, prepared)
        if not skip_check:
            note("checking disk, rig and picture (--skip-check skips this)")
            flight = with_progress(acquisition.preflights.preflight)(
                opened, chosen, out, self_test=tested
            )
            take_findings(flight, prepared, accepting)
        prepared.warnings += acquisition.engine.camera_notices(opened, out)
        for warning in prepared.warnings:
            report(warning)
        if stream is not None:
            stream.started(out, rig_name, chosen, chosen.shots())
        again = ResumeCommand(out, rig_name, skip_check)
        with CaptureTalk(again, accepting=accepting, stream=stream) as talk:
            session = acquisition.record(
                opened,
                chosen,
                out,
                acquisition.Labels(operator_name, object_name, place, notes, rights),
                events=prepared.events,
                calibrations=acquisition.Calibrations(
                    camera_model=model,
                    sensor=None if measured is None else measured.noise_model(),
                    lights=None if given is None else given.lights,
                ),
                hooks=talk.hooks,
            )
    return judge_frames(describe(session, prepared.warnings), session)


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
    stream = EventStream() if events else None
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
        _, recorded, missing = acquisition.engine.check_resume(
            opened, session, asked, damaged=damaged
        )
        if dry_run:
            return rehearsed(opened, recorded, missing)
        if begun.lost_lines:
            report(begun.lost_lines)
        prepared, accepting = Preparation(), Acceptance(accept, stream)
        if not skip_check:
            alive, _ = recorded.without(opened.config.dead_leds)
            flight = with_progress(acquisition.preflights.preflight_resume)(
                opened, alive, session, len(missing)
            )
            take_findings(flight, prepared, accepting)
        prepared.warnings += acquisition.engine.camera_notices(opened, session)
        # An operator who resumes with only flats missing has placed the card; this does not hold
        # for damaged flats.
        only_flats = bool(missing) and all(shot.role == "flat" for shot in missing) and not damaged
        if stream is not None:
            stream.started(session, rig_name, recorded, missing)
        talking = CaptureTalk(again, card_is_there=only_flats, accepting=accepting, stream=stream)
        with talking as talk:
            finished = acquisition.resume(
                opened,
                session,
                plan=asked,
                events=prepared.events,
                retake_damaged=retake_damaged,
                hooks=talk.hooks,
            )
    text = f"missing shots that have been taken: {len(missing)}"
    taken = rigs.Notice("shots-taken", text, severity="info")
    noticed = [*begun.warnings, taken, *left_out_notices(finished), *prepared.warnings]
    return judge_frames(describe(finished, noticed), finished)


def _measured_sensor(option: Path | None, rig_name: str) -> acquisition.MeasuredSensor | None:
    """Return the sensor of the option, or else that of the rig file, if it names one."""
    if option is not None:
        return acquisition.value_files.read_sensor(option)
    configured = rigs.find_rig_config(rig_name).sensor
    if configured is None:
        return None
    try:
        return acquisition.value_files.read_sensor(configured)
    except (acquisition.DataError, acquisition.MissingPathError) as error:
        error.add_note(f"`sensor` in {rig_name} names it")
        raise


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


def _upright_size(rig: rigs.Rig) -> tuple[int, int]:
    info = rig.camera.info
    height, width = rig.config.mounting.upright_shape((info.height, info.width))
    return height, width


def _setup(rig: rigs.Rig) -> acquisition.Setup:
    info = rig.camera.info
    return acquisition.Setup(rig.config.name, info.vendor, info.model, info.serial)
