"""The capture engine: run a plan on a rig to record a session, or to rehearse it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from acquisition._errors import DataError
from acquisition.engine.camera_settings import settings_events
from acquisition.engine.object_check import check_object
from acquisition.engine.recording_loop import RecordingHooks
from acquisition.engine.recording_run import STALL_S, carry_out
from acquisition.engine.rejection import References
from acquisition.engine.rig_records import (
    camera_record,
    check_calibrations,
    check_exposures,
    check_same,
    rig_record,
)
from acquisition.engine.stop_request import StopRequest
from acquisition.plan.plan import CapturePlan
from acquisition.plan.planned_shot import PlannedShot
from acquisition.session.event_details import check_event
from acquisition.session.journal import COMPARED, LEFT_OUT
from acquisition.session.manifest import FORMAT_VERSION, Calibrations, Labels, Manifest
from acquisition.session.session import Session
from acquisition.session.session_frame import Damage
from acquisition.session.writer import SessionWriter
from rig import Progress, Rig, no_progress
from rig.host import clock


def record(
    rig: Rig,
    plan: CapturePlan,
    folder: str | Path,
    labels: Labels,
    *,
    calibrations: Calibrations = Calibrations(),
    hooks: RecordingHooks = RecordingHooks(),
    events: Sequence[tuple[str, Mapping[str, Any]]] = (),
    stall_s: float = STALL_S,
    stop: StopRequest | None = None,
) -> Session:
    """Record one object: take every shot of the plan and store it while the next is taken.

    Parameters
    ----------
    rig
        Open rig. It stays open.
    plan
        Capture plan. LEDs that the rig file lists as dead are left out, and an event records this.
    folder
        New or empty folder for the session.
    labels
        Texts for people: operator, object, place.
    calibrations
        Camera model, sensor and lights to store with the recording, if known.
    hooks
        Callbacks that report progress.
    events
        Earlier events, for instance metering; they are written first.
    stall_s
        Longest time without a finished write before the disk counts as stuck, seconds.
    stop
        Through which another thread may end the recording after a shot, as Ctrl-C does.

    Returns
    -------
    Session
        The complete session.

    Raises
    ------
    DataError
        If the plan does not fit the rig, a calibration does not fit the camera, lights are missing
        for an LED of the plan, an event does not follow the format, a frame differs from the
        camera's description, or too much of it is clipped.
    StorageError
        If the folder is not empty, inside a session or in use, or the disk refuses a write or is
        stuck.
    RigError
        If board or camera fail, or an LED gives no light, more often than the plan's ``retakes``.
    NotAcceptedError
        If a repeat shows what ``hooks.accept`` does not accept, and lights are left.
    KeyboardInterrupt
        After Ctrl-C or a request of ``stop``. The first Ctrl-C lets the current shot and all writes
        finish, the second ends the recording immediately.

    Notes
    -----
    The calling thread takes the shots, and two other threads write them. If the disk is slower than
    the camera, the recording pauses with all LEDs off. After any error, including
    KeyboardInterrupt, the LEDs are turned off first, then the frames taken so far are written, and
    then the error is raised. The session stays intact but incomplete, with an ``interrupted`` or
    ``failed`` event if the disk still accepts one; `resume` completes it.

    Examples
    --------
    >>> from acquisition import CapturePlan, Labels, record
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("coin", width=64, height=52, leds=4))
    >>> plan = CapturePlan(leds="0-3", exposures_us=(20_000.0,))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     session = record(rig, plan, "coin", Labels(operator="me"))
    >>> session
    Session(coin, 6 frames, complete)
    """
    _check_events(events, folder)
    plan, left_out = plan.without(rig.config.dead_leds)
    plan.check(rig.config.leds)
    check_exposures(rig.camera.info, plan)
    check_calibrations(rig, plan, calibrations)
    for exposure_us in plan.distinct_exposures_us:
        rig.prepare(exposure_us, plan.gain_db)
    manifest = _manifest(rig, folder, calibrations, labels=labels, plan=plan)
    events = [*events, *settings_events(rig.camera.info)]
    if left_out:
        events = [*events, (LEFT_OUT, {"leds": list(left_out), "reason": "listed as dead"})]
    with SessionWriter.create(folder, manifest) as writer:
        carry_out(
            rig,
            writer,
            plan,
            hooks,
            events,
            References(manifest.camera),
            stall_s,
            stop or StopRequest(),
        )
    return Session.open(folder)


def resume(
    rig: Rig,
    folder: str | Path,
    *,
    plan: CapturePlan | None = None,
    events: Sequence[tuple[str, Mapping[str, Any]]] = (),
    retake_damaged: bool = False,
    hooks: RecordingHooks = RecordingHooks(),
    stall_s: float = STALL_S,
    stop: StopRequest | None = None,
) -> Session:
    """Take the missing shots of a session, and no others.

    Unless the plan has ``repeat = False``, the last light is taken again first and compared with
    its frame: another object under the camera, or a shift, ends the call before anything is
    written, unless ``hooks.accept`` accepts it.

    Shots of LEDs that the rig file now lists as dead are left out, and an event records this; the
    session becomes complete without them. Frames that were recorded before are read back while the
    writers are idle; a session with a damaged frame does not become complete.

    Parameters
    ----------
    rig
        Open rig, the same as when the session was started.
    folder
        An incomplete session.
    plan
        If given, refuse a session with a different plan.
    retake_damaged
        Read all frames back first, set damaged and lost ones aside (their files are kept in
        ``derived/set_aside/``), and take their shots again; each is recorded as an event. The
        object must not have moved. A complete session with such a frame is resumed, too.
    hooks, events, stall_s, stop
        As for `record`.

    Returns
    -------
    Session
        The complete session.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If it is not a session, is damaged or complete, was imported, or was started with another
        rig, camera or plan; the message names the differences. If every LED of its plan is dead.
        If a frame is damaged; in this case the missing shots have been taken.
    NotAcceptedError
        If another object is under the camera, or it moved: nothing was changed. As for `record`.
    StorageError, RigError, KeyboardInterrupt
        As for `record`.

    Examples
    --------
    >>> from acquisition import CapturePlan, Labels, record, resume
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("coin", width=64, height=52, leds=4))
    >>> plan = CapturePlan(leds="0-3", exposures_us=(20_000.0,))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     session = record(rig, plan, "coin", Labels())
    ...     session.frames[2].path.unlink()
    ...     session = resume(rig, "coin", retake_damaged=True)
    >>> session
    Session(coin, 6 frames, complete)
    """
    folder = Path(folder)
    _check_events(events, folder)
    session, recorded = _fitting(rig, folder, plan, retake_damaged=retake_damaged)
    events = [*events, *settings_events(rig.camera.info)]
    # For flats, the card is already under the camera.
    needed = retake_damaged or any(shot.role != "flat" for shot in session.missing)
    if recorded.repeat and needed:
        compared = check_object(rig, session, recorded, hooks.accept)
        events = [*events, *([] if compared is None else [(COMPARED, compared)])]
    with SessionWriter.reopen(
        folder,
        set_aside_damaged=retake_damaged,
        on_progress=hooks.on_progress,
    ) as writer:
        # Read it again now that no other process can add to it.
        session = Session.open(folder)
        references = References.of(session)
        for line in writer.set_aside_events:
            hooks.on_event(line.event, line.details)
        died = sorted(set(rig.config.dead_leds) & {shot.led for shot in writer.missing})
        if died:
            details = {"leds": died, "reason": "listed as dead"}
            writer.write_event(LEFT_OUT, **details)
            hooks.on_event(LEFT_OUT, details)
        carry_out(rig, writer, recorded, hooks, events, references, stall_s, stop or StopRequest())
    return Session.open(folder)


def check_resume(
    rig: Rig,
    folder: str | Path,
    plan: CapturePlan | None = None,
    *,
    damaged: Iterable[Damage] | None = None,
) -> tuple[Session, CapturePlan, tuple[PlannedShot, ...]]:
    """Check that a session can be resumed on this rig, without changing anything.

    Parameters
    ----------
    rig, folder, plan
        As for `resume`.
    damaged
        Result of `damaged_frames` if these frames should be retaken.

    Returns
    -------
    Session, CapturePlan, PlannedShots
        The session, its plan, and the shots to take: those whose LED works and that are missing or
        have a damaged frame.

    Raises
    ------
    MissingPathError, DataError
        As `resume`.

    Examples
    --------
    >>> from acquisition import CapturePlan, Labels, record
    >>> from acquisition.engine import check_resume
    >>> from acquisition.session import damaged_frames
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("coin", width=64, height=52, leds=4))
    >>> plan = CapturePlan(leds="0-3", exposures_us=(20_000.0,))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     session = record(rig, plan, "coin", Labels())
    ...     session.frames[2].path.unlink()
    ...     _, _, shots = check_resume(rig, "coin", damaged=damaged_frames("coin"))
    >>> [shot.file for shot in shots]
    ['L01_E0.tif']
    """
    session, recorded = _fitting(rig, Path(folder), plan, retake_damaged=damaged is not None)
    missing = session.missing_without(one.frame for one in damaged or ())
    dead = rig.config.dead_leds
    return session, recorded, tuple(shot for shot in missing if shot.led not in dead)


def rehearse(
    rig: Rig,
    plan: CapturePlan,
    *,
    on_progress: Progress = no_progress,
    shots: Sequence[PlannedShot] | None = None,
) -> float:
    """Take every shot of a plan as a recording would, but with all LEDs off, and store nothing.

    Parameters
    ----------
    rig
        Open rig. It stays open, with all LEDs off.
    plan
        Plan to rehearse, without LEDs that are listed as dead.
    on_progress
        Receives the stage ``dry run``, one step per shot.
    shots
        If given, take only these shots of the plan.

    Returns
    -------
    float
        Duration of the shots in seconds, without writing, metering or retakes.

    Raises
    ------
    RigError
        If board or camera fail.
    DataError
        If a shot has no exposure.

    Examples
    --------
    >>> from acquisition import CapturePlan
    >>> from acquisition.engine import rehearse
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("coin", width=64, height=52, leds=4))
    >>> plan = CapturePlan(leds="0-3", exposures_us=(20_000.0,))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     seconds = rehearse(rig, plan)
    >>> 0 < seconds < 10
    True
    """
    began_s = clock.monotonic()
    chosen = plan.shots() if shots is None else shots
    done = 0
    for exposure_us, alike in groupby(chosen, key=lambda shot: shot.exposure_us):
        if exposure_us is None:
            raise DataError("the plan gives no exposure")
        dark = [None for _ in alike]
        if plan.sequence and rig.config.trigger == "board":
            taken = rig.sequence(dark, exposure_us, plan.gain_db)
        else:
            taken = (rig.shoot(None, exposure_us, plan.gain_db) for _ in dark)
        for _ in taken:
            done += 1
            on_progress("dry run", done, len(chosen))
    return clock.monotonic() - began_s


def _fitting(
    rig: Rig, folder: Path, plan: CapturePlan | None, *, retake_damaged: bool
) -> tuple[Session, CapturePlan]:
    """Return a session and its plan after checking that this rig can resume it."""
    session = Session.open(folder, damaged_frames=retake_damaged)
    manifest, recorded = session.manifest, session.manifest.plan
    if session.complete and not retake_damaged:
        raise DataError(f"{folder}: is complete, nothing is missing; record into a new folder")
    if manifest.rig is None or recorded is None:
        raise DataError(f"{folder}: was not recorded on a rig; import its missing images instead")
    manifest.check_current(folder)
    if plan is not None:
        plan = manifest.planned(plan)
    # The manifest that the session would have if it started now with this rig.
    current = _manifest(rig, folder, Calibrations(sensor=session.sensor))
    check_same(folder, manifest, current, plan)
    recorded.without(rig.config.dead_leds)
    return session, recorded


def _check_events(events: Iterable[tuple[str, Mapping[str, Any]]], folder: str | Path) -> None:
    """Refuse invalid events before anything is recorded."""
    for event, details in events:
        check_event(event, details, FORMAT_VERSION, Path(folder))


def _manifest(rig: Rig, folder: str | Path, calibrations: Calibrations, **others: Any) -> Manifest:
    return Manifest.begin(
        folder,
        rig=rig_record(rig),
        camera=camera_record(rig.camera.info, calibrations.sensor),
        calibrations=calibrations,
        **others,
    )
