"""A recording on an open rig with the steps around it, as `capture run` and the screen do it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from cyclopts import Parameter

import acquisition
import rig as rigs
from acquisition.session import Damage
from sgp.cli.console import note, report, with_progress
from sgp.cli.options import OptionalInput, OptionalLights
from sgp.results import Result
from sgp.rigs import chosen_operator, given_lights
from sgp.sessions.acceptance import Acceptance
from sgp.sessions.operator_messages import CaptureTalk
from sgp.sessions.resume_command import ResumeCommand
from sgp.sessions.session_summary import describe, left_out_notices
from sgp.sessions.session_verdict import judge_frames
from sgp.sessions.steps import Preparation, checked_wiring, metered, take_findings

if TYPE_CHECKING:
    from acquisition.engine import StopRequest


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class StoredOptions:
    """What sessions store besides the frames.

    Parameters
    ----------
    operator
        Name of the operator; default: `operator` in the configuration file.
    place
        Place of the recording.
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
    """

    operator: str | None = None
    place: str = ""
    rights: str = ""
    camera: OptionalInput = None
    lights: OptionalLights = None
    sensor: OptionalInput = None


@dataclass(frozen=True)
class Order:
    """What is recorded besides the plan, with all files read that need no rig.

    Parameters
    ----------
    rig_name
        Name of the rig, or path of its file.
    options
        What the session stores.
    operator
        Name of the operator.
    lights
        Lights to store.
    sensor
        Sensor to store.
    """

    rig_name: str
    options: StoredOptions
    operator: str
    lights: acquisition.Lights | None
    sensor: acquisition.MeasuredSensor | None

    @classmethod
    def read(cls, rig_name: str, rig_option: Path | None, options: StoredOptions) -> Self:
        """Read the files that options name.

        Raises
        ------
        MissingPathError, DataError
            If a file is missing or invalid.
        UsageError
            If no rig with positions is known for the lights of the rig.
        """
        return cls(
            rig_name,
            options,
            chosen_operator(options.operator),
            None if options.lights is None else given_lights(options.lights, option=rig_option)[0],
            _measured_sensor(options.sensor, rig_name),
        )

    def labels(self, object_name: str, notes: str) -> acquisition.Labels:
        """Return the labels of a session."""
        place, rights = self.options.place, self.options.rights
        return acquisition.Labels(self.operator, object_name, place, notes, rights)

    def calibrations(self, rig: rigs.Rig) -> acquisition.Calibrations:
        """Return the calibrations to store.

        Raises
        ------
        MissingPathError, DataError
            If the camera file is missing, invalid, or for another image size.
        """
        info, file = rig.camera.info, self.options.camera
        height, width = rig.config.mounting.upright_shape((info.height, info.width))
        return acquisition.Calibrations(
            camera_model=None if file is None else acquisition.read_camera(file, (height, width)),
            sensor=None if self.sensor is None else self.sensor.noise_model(),
            lights=self.lights,
        )


def record_on_rig(
    rig: rigs.Rig,
    plan: acquisition.CapturePlan,
    left_out: Sequence[int],
    out: Path,
    order: Order,
    labels: acquisition.Labels,
    *,
    goal: acquisition.metering.MeteringGoal | None = None,
    skip_check: bool = False,
    accepting: Acceptance,
    stop: StopRequest | None = None,
) -> Result:
    """Meter and check as requested, record a session, and judge its frames.

    Parameters
    ----------
    rig
        Open rig.
    plan, left_out
        Plan without the dead LEDs, and those that it leaves out.
    out
        New folder for the session.
    order, labels
        What the session stores.
    goal
        Goal of metering; None to use the plan's exposure times.
    skip_check
        Whether to skip the checks.
    accepting
        Answers to findings that make a recording useless, and those who follow it.
    stop
        Request to end it early.

    Raises
    ------
    DataError, StorageError, RigError, NotAcceptedError, KeyboardInterrupt
        As `acquisition.record`, and if a check failed.
    """
    calibrations = order.calibrations(rig)
    prepared = Preparation()
    prepared.warnings += () if order.lights is None else order.lights.warnings
    if left_out:
        dead = {"leds": list(left_out), "reason": "listed as dead"}
        prepared.events.append(("left_out", dead))
        text = f"LED {', '.join(map(str, left_out))} skipped: listed in dead_leds"
        prepared.warnings.append(rigs.Notice("leds-skipped", text, severity="info"))
    if order.sensor is not None:
        prepared.warnings += acquisition.source.sensor_notices(
            order.sensor, _setup(rig), plan.gain_db
        )
    tested: bool | acquisition.preflights.Check = True
    if goal is not None:
        if not skip_check:  # metering swapped LEDs would waste minutes
            note("checking the wiring of the LEDs (--skip-check skips this)")
            tested = checked_wiring(rig, plan)
        plan = metered(rig, plan, goal, prepared)
    if not skip_check:
        note("checking disk, rig and picture (--skip-check skips this)")
        flight = with_progress(acquisition.preflights.preflight)(rig, plan, out, self_test=tested)
        take_findings(flight, prepared, accepting)
    prepared.warnings += acquisition.engine.camera_notices(rig, out)
    for warning in prepared.warnings:
        report(warning)
    accepting.audience.started(out, order.rig_name, plan, plan.shots())
    again = ResumeCommand(out, order.rig_name, skip_check)
    with CaptureTalk(again, accepting=accepting) as talk:
        session = acquisition.record(
            rig,
            plan,
            out,
            labels,
            events=prepared.events,
            calibrations=calibrations,
            hooks=talk.hooks,
            stop=stop,
        )
    return judge_frames(describe(session, prepared.warnings), session)


def resume_on_rig(
    rig: rigs.Rig,
    begun: acquisition.Session,
    again: ResumeCommand,
    *,
    asked: acquisition.CapturePlan | None = None,
    damaged: tuple[Damage, ...] | None = None,
    accepting: Acceptance,
    stop: StopRequest | None = None,
) -> Result:
    """Check as requested, take the missing shots of a session, and judge its frames.

    Parameters
    ----------
    rig
        Open rig.
    begun
        The session.
    again
        The command that resumes it.
    asked
        If given, refuse a session with another plan.
    damaged
        The damaged frames to take again; None to take none again.
    accepting, stop
        See `record_on_rig`.

    Raises
    ------
    DataError, StorageError, RigError, NotAcceptedError, KeyboardInterrupt
        As `acquisition.resume`, and if a check failed.
    """
    folder = begun.folder
    _, recorded, missing = acquisition.engine.check_resume(rig, folder, asked, damaged=damaged)
    if begun.lost_lines:
        report(begun.lost_lines)
    prepared = Preparation()
    if not again.skip_check:
        alive, _ = recorded.without(rig.config.dead_leds)
        flight = with_progress(acquisition.preflights.preflight_resume)(
            rig, alive, folder, len(missing)
        )
        take_findings(flight, prepared, accepting)
    prepared.warnings += acquisition.engine.camera_notices(rig, folder)
    # An operator who resumes with only flats missing has placed the card; this does not hold
    # for damaged flats.
    only_flats = bool(missing) and all(shot.role == "flat" for shot in missing) and not damaged
    accepting.audience.started(folder, again.rig or rig.config.name, recorded, missing)
    with CaptureTalk(again, card_is_there=only_flats, accepting=accepting) as talk:
        finished = acquisition.resume(
            rig,
            folder,
            plan=asked,
            events=prepared.events,
            retake_damaged=damaged is not None,
            hooks=talk.hooks,
            stop=stop,
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


def _setup(rig: rigs.Rig) -> acquisition.Setup:
    info = rig.camera.info
    return acquisition.Setup(rig.config.name, info.vendor, info.model, info.serial)
