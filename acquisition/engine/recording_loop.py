"""The loop of a recording: this thread takes the shots while others write them."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, Final, cast

from acquisition._errors import DataError, NotAcceptedError
from acquisition.engine.rejection import References, SeenLight, quality_of, rejection
from acquisition.engine.repeat_watch import RepeatWatch
from acquisition.engine.shot_order import Agenda
from acquisition.engine.stop_request import StoppedError, StopRequest
from acquisition.engine.write_queue import Turn, WriteQueue
from acquisition.pixels.frame_quality import FrameQuality, above_dark
from acquisition.plan.plan import CapturePlan
from acquisition.plan.planned_shot import PlannedShot, ShotKey
from acquisition.session.comparisons import USELESS, compared_repeats
from acquisition.session.frame_proofs import CHECKING
from acquisition.session.journal import ACCEPTED, COMPARED, Echo, FrameLine
from acquisition.session.layout import WRITERS
from acquisition.session.light_proof import BOARD, RIG, wrong_light
from acquisition.session.session import Session
from acquisition.session.writer import CameraReport, SessionWriter
from rig import (
    DeviceGoneError,
    FrameLostError,
    FrameTimeoutError,
    Notice,
    Progress,
    Rig,
    RigError,
    Shot,
    no_progress,
)
from rig.host import clock

OnFrame = Callable[[FrameLine], None]
OnEvent = Callable[[str, Mapping[str, Any]], None]
OnDoubt = Callable[[Notice], bool]
# Frames that may wait for the disk, in addition to those in the camera's buffers.
ROOM: Final = 5
# Two: while one waits for the disk to flush, the other computes.
THREADS: Final = WRITERS
# Retakes of a shot whose frame was lost, even if the plan allows fewer: the loss has nothing to do
# with the object or the light.
LOST_RETAKES: Final = 3
# A device that is gone so many times, without a frame in between, is broken.
_LOSSES_IN_A_ROW: Final = 10
# Interval between looks at the checks and at Ctrl-C.
_LOOK_S: Final = 0.2


def _nothing(*_: object) -> None:
    """Do nothing: the callback of a caller that does not listen."""


def _refuse_useless(finding: Notice) -> bool:
    """Accept findings that do not make further frames useless."""
    return finding.code not in USELESS


@dataclass(frozen=True)
class RecordingHooks:
    """Callbacks of a recording.

    All except ``on_stop`` are called on the thread that takes the shots, between two shots.

    Parameters
    ----------
    on_frame
        Called with its line when a frame that counts is safe on disk.
    on_progress
        Receives the stage ``recording``, one step per frame that counts, and after the last shot
        the stage ``checking recorded frames`` while earlier frames are read back.
    on_event
        Called for each event that is written to the journal, with its name and details.
    on_stop
        Called inside the signal handler when Ctrl-C is pressed once.
    on_damage
        Called when a frame that was recorded earlier turns out to be damaged, with a description in
        one line. The missing shots are still taken; then the recording ends with this error.
    accept
        Asked about each finding of a repeat, with all LEDs off; returns whether to continue. By
        default those after which further frames would not fit those recorded before are refused.
        Before a session is resumed only these are asked about.
    before_flats
        Called once before the first flat. When it returns, the white card must be under the camera,
        unless Ctrl-C was pressed meanwhile.
    """

    on_frame: OnFrame = _nothing
    on_progress: Progress = no_progress
    on_event: OnEvent = _nothing
    on_stop: Callable[[], None] = _nothing
    on_damage: Callable[[str], None] = _nothing
    accept: OnDoubt = _refuse_useless
    before_flats: Callable[[], None] = _nothing


@dataclass(frozen=True)
class Stored:
    """A frame that is on disk, and the reason why it was rejected, if it was."""

    shot: PlannedShot
    line: FrameLine
    rejected: RigError | DataError | None


class Recording:
    """Takes the missing shots of a session.

    Parameters
    ----------
    rig
        Open rig.
    writer
        Open writer of the session.
    plan
        Plan of the session.
    queue
        Queue for the frames and events to write.
    hooks
        Callbacks that report progress.
    references
        Figures of the frames that were recorded before.
    watch
        Compares repeats of the session.
    """

    def __init__(
        self,
        rig: Rig,
        writer: SessionWriter,
        plan: CapturePlan,
        queue: WriteQueue[Stored | None],
        hooks: RecordingHooks,
        references: References,
        watch: RepeatWatch,
    ) -> None:
        self._rig = rig
        self._writer = writer
        self._plan = plan
        self._queue = queue
        self._hooks = hooks
        self._references = references
        self._watch = watch
        self._rejection = partial(
            rejection,
            range_dn=references.range_dn,
            max_clipped_fraction=plan.max_clipped_fraction,
        )
        # Exposure times so short that a frame without visible light was kept.
        self._unseen_us: set[float] = set()
        self._todo = Agenda(writer.missing)
        self._total = writer.shots.demanded
        self._done = self._total - len(self._todo)
        self._failures: Counter[ShotKey] = Counter()
        self._losses: Counter[ShotKey] = Counter()
        # If no frame ever arrived, the trigger wire may be missing.
        self._delivered = False
        self._gone_in_a_row = 0
        self._sequenced = plan.sequence and rig.config.trigger == "board"
        self._card_in_place = False
        self._damaged: set[int] = set()

    def run(self, stop: StopRequest) -> None:
        """Take every shot, and wait until all are safe on disk.

        Raises
        ------
        StoppedError
            If a stop was requested and shots are left.
        RigError, DataError, StorageError
            If a shot cannot be taken, is rejected too often, or cannot be written.
        NotAcceptedError
            If a finding of a repeat is not accepted and lights are left.
        """
        if self._plan.sequence and not self._sequenced:
            trigger = self._rig.config.trigger
            self.event("not_sequenced", reason=f"the rig file has trigger = {trigger!r}")
        while self._todo or not (self._queue.settled and self._watch.settled):
            if not self._todo:
                self._queue.drain()
                self._watch.wait()
            self.collect()
            self._ask(stop)
            if stop.asked and self._todo:
                raise StoppedError(stop, "after a shot")
            try:
                if self._queue.full:
                    self._pause()
                elif self._todo:
                    self._take(stop)
            except DeviceGoneError as error:
                self._reconnect(error, stop)

    def wait_for_checks(self, stop: StopRequest) -> None:
        """Wait until idle writers have read back all frames of earlier processes.

        Raises
        ------
        StoppedError
            If a stop was requested meanwhile.
        DataError
            If one is damaged.
        StorageError
            If the disk does not respond.
        """
        while not self._queue.rests(_LOOK_S):
            self._report_damage()
            self._hooks.on_progress(CHECKING, *self._writer.proofs.checked)
            if stop.asked:
                raise StoppedError(stop, "while earlier frames were checked")
        self._report_damage()
        self._writer.proofs.check_undamaged()

    def _ask(self, stop: StopRequest) -> None:
        """Ask whether to take further lights after what the repeats show."""
        while self._watch.findings:
            finding = self._watch.findings.pop(0)
            if self._todo.lights_left:
                self._rig.off()
                accepted = self._hooks.accept(finding)
                if stop.asked:
                    return
                if not accepted:
                    raise NotAcceptedError(finding)
                self.event(ACCEPTED, file=Path(finding.where).name, code=finding.code)

    def compare_repeats(self) -> None:
        """Compare each repeat that was not compared yet with its light, and write the result.

        Raises
        ------
        DataError
            If one of the two frames is damaged.
        StorageError
            If the disk refuses.
        """
        for details in compared_repeats(Session.open(self._writer.folder)):
            self._writer.write_event(COMPARED, **details)
            self._hooks.on_event(COMPARED, details)

    def _report_damage(self) -> None:
        for damage in self._writer.proofs.damage:
            if damage.frame.line.seq not in self._damaged:
                self._damaged.add(damage.frame.line.seq)
                self._hooks.on_damage(damage.text)

    def collect(self) -> None:
        """Report the frames written since the last call, and queue rejected shots again."""
        self._report_damage()
        for stored in self._queue.results():
            if stored is None:
                continue
            if stored.rejected is not None:
                self._failed(stored.shot, stored.rejected)
                self._todo.again(stored.shot)
                continue
            self._done += 1
            self._note_light(stored)
            self._hooks.on_frame(stored.line)
            self._hooks.on_progress("recording", self._done, self._total)
            if stored.shot.role == "repeat" and self._todo.lights_left:
                self._watch.compare(stored.line.file)
        for details in self._watch.collect():
            self.event(COMPARED, **details)

    def _note_light(self, stored: Stored) -> None:
        """Note the light of a frame; report the first frame of an exposure that shows none."""
        shot = stored.shot
        if shot.led is None or self._references.note(shot, quality_of(stored.line)):
            return
        exposure_us = _exposure_us(shot)
        if exposure_us not in self._unseen_us:
            self._unseen_us.add(exposure_us)
            self.event("no_light_seen", led=shot.led, exposure_us=exposure_us)

    def event(self, name: str, **details: Any) -> None:
        """Queue an event for writing, and report it."""
        self._queue.put(partial(self._write_event, name, details))
        self._hooks.on_event(name, details)

    def _take(self, stop: StopRequest) -> None:
        first = self._todo.first
        if first.role == "flat" and not self._card_in_place:
            self._rig.off()
            if not self._queue.settled:
                # Shots that may still be rejected are retaken before the card hides the object.
                self._queue.drain()
                return
            self._hooks.before_flats()
            if stop.asked:
                return
            self._card_in_place = True
        if first.role == "repeat" and not self._watch.settled:
            # The one before is judged first, and perhaps ends the recording.
            self._rig.off()
            self._watch.wait()
            return
        can_be_judged = self._dark_is_known(first) and self._longer_is_known(first)
        if not can_be_judged and not self._queue.settled:
            self._queue.drain()
        elif self._sequenced:
            self._take_many(stop)
        else:
            self._take_one(stop)

    @property
    def _has_darks(self) -> bool:
        return self._plan.dark or self._plan.ambient

    def _dark_is_known(self, shot: PlannedShot) -> bool:
        """Return whether the dark frame for comparison is known, or none is planned."""
        unjudged = shot.led is None or not self._has_darks
        return unjudged or self._references.dark(shot) is not None

    def _longer_is_known(self, shot: PlannedShot) -> bool:
        """Return whether the LED was seen at a longer exposure, or none is planned."""
        if shot.led is None or not self._has_darks or self._references.light(shot) is not None:
            return True
        return _exposure_us(shot) >= max(self._plan.exposures_of(shot.led))

    def _take_one(self, stop: StopRequest) -> None:
        planned = self._todo.first
        try:
            shot = self._rig.shoot(planned.led, _exposure_us(planned), self._plan.gain_db)
        except RigError as error:
            _end_if_stopped(stop, error)
            self._failed(planned, error)
        else:
            if self._is_of(planned, shot):
                self._todo.take()
                self._keep(planned, shot)

    def _take_many(self, stop: StopRequest) -> None:
        """Take all shots that fit one sequence, or as many as fit into the queue."""
        first = self._todo.first
        group = self._todo.take(lambda shot: self._may_follow(first, shot))
        leds = [shot.led for shot in group]
        shots = self._rig.sequence(leds, _exposure_us(first), self._plan.gain_db)
        with closing(cast(Generator[Shot, None, None], shots)) as sequence:
            while (shot := self._next(sequence, group, stop)) is not None:
                if not self._is_of(group[0], shot):
                    break
                counts = self._keep(group.popleft(), shot)
                self.collect()
                ends = stop.asked or self._queue.full or self._watch.findings or not counts
                if group and ends:
                    break
        self._todo.put_back(group)

    def _may_follow(self, first: PlannedShot, shot: PlannedShot) -> bool:
        """Return whether a shot may be in the same sequence as the first one."""
        flats = first.role == "flat", shot.role == "flat"
        if shot.exposure_us != first.exposure_us or flats[0] != flats[1] or shot.role == "repeat":
            return False
        # Frames without light are measured as soon as they arrive.
        dark = first.led is None or self._dark_is_known(shot)
        return dark and self._longer_is_known(shot)

    def _next(
        self, sequence: Iterator[Shot], group: deque[PlannedShot], stop: StopRequest
    ) -> Shot | None:
        try:
            return next(sequence, None)
        except DeviceGoneError:
            self._todo.put_back(group)
            raise
        except RigError as error:
            _end_if_stopped(stop, error)
            self._failed(group[0], error)
            return None

    def _is_of(self, planned: PlannedShot, shot: Shot) -> bool:
        """Return whether a frame was lit as planned; if not, note the failure and drop it."""
        lit = {RIG: shot.led} | ({} if shot.echo is None else {BOARD: shot.echo.led})
        conflict = wrong_light(planned, lit)
        if conflict is not None:
            error = RigError(
                f"{planned.file}: {conflict}; the frame was not kept: check the LED board and its "
                "wiring"
            )
            self._failed(planned, error)
        return conflict is None

    def _keep(self, planned: PlannedShot, shot: Shot) -> bool:
        """Queue a frame for writing; return False if it is already known to be rejected."""
        self._delivered = True
        self._gone_in_a_row = 0
        quality, counts = None, True
        if planned.led is None:
            # Measured now, because later frames are compared with it.
            quality = self._writer.measure(planned, shot.frame.pixels)
            counts = self._rejection(planned, quality, dark=None) is None
            if counts:
                self._references.note(planned, quality)
        dark, light = self._references.dark(planned), self._references.light(planned)
        self._queue.put(partial(self._store, planned, shot, quality, dark, light))
        return counts

    def _pause(self) -> None:
        self._rig.off()
        self.event("paused", reason="frames wait for the disk", waiting=ROOM)
        began_s = clock.monotonic()
        self._queue.wait_for_room()
        self.event("resumed", seconds=round(clock.monotonic() - began_s, 3))

    def _reconnect(self, error: DeviceGoneError, stop: StopRequest) -> None:
        """Wait until a device that is gone is back; its shot is then taken again."""
        self._gone_in_a_row += 1
        if not self._rig.config.reconnect_s or self._gone_in_a_row > _LOSSES_IN_A_ROW:
            raise error
        self.event("device_lost", device=error.device, reason=str(error))
        began_s = clock.monotonic()

        def end_if_asked() -> None:
            if stop.asked:
                raise StoppedError(stop, f"while the {error.device} was gone")

        self._rig.recover(error, end_if_asked)
        seconds = round(clock.monotonic() - began_s, 3)
        self.event("device_returned", device=error.device, seconds=seconds)

    def _failed(self, shot: PlannedShot, error: RigError | DataError) -> None:
        """Note that a shot must be taken again, or raise the error after too many failures."""
        if isinstance(error, DeviceGoneError):
            raise error
        counts, most = self._failures, self._plan.retakes
        if isinstance(error, FrameLostError):
            self.event("frames_lost", file=shot.file, led=shot.led, **error.counts)
            counts = self._losses
            if self._frames_arrive(error):
                most = max(most, LOST_RETAKES)
        counts[shot.key] += 1
        failures = counts[shot.key]
        if failures > most:
            if failures > 1:
                error.add_note(f"{shot.file} was taken {failures} times")
            raise error
        self.event("retake", file=shot.file, led=shot.led, reason=str(error), failures=failures)

    def _frames_arrive(self, error: FrameLostError) -> bool:
        """Return whether frames arrive at all, so that only some were lost."""
        waited = isinstance(error, FrameTimeoutError)
        return not waited or self._delivered or error.counts.get("delivered", 0) > 0

    def _store(
        self,
        planned: PlannedShot,
        shot: Shot,
        quality: FrameQuality | None,
        dark: FrameQuality | None,
        light: SeenLight | None,
        turn: Turn,
    ) -> Stored:
        frame, range_dn = shot.frame, self._references.range_dn
        quality = quality or self._writer.measure(planned, frame.pixels)
        rejected = self._rejection(planned, quality, dark=dark, seen=light)
        line = self._writer.write_frame(
            planned,
            frame.pixels,
            report=CameraReport(
                **{item.name: getattr(frame, item.name) for item in fields(CameraReport)}
            ),
            echo=None if shot.echo is None else Echo(**asdict(shot.echo)),
            status="ok" if rejected is None else "rejected",
            quality=quality,
            above_dark=None if planned.led is None else above_dark(quality, dark, range_dn),
            before_line=turn,
        )
        return Stored(planned, line, rejected)

    def _write_event(self, name: str, details: Mapping[str, Any], turn: Turn) -> None:
        turn()
        self._writer.write_event(name, **details)


def _end_if_stopped(stop: StopRequest, error: RigError) -> None:
    """End the recording if a stop, which may turn the LED off at once, spoiled the shot."""
    if stop.asked:
        raise StoppedError(stop, "during a shot") from error


def _exposure_us(shot: PlannedShot) -> float:
    if shot.exposure_us is None:
        raise DataError(f"{shot.file}: the plan gives no exposure")
    return shot.exposure_us
