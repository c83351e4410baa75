"""The loop of a recording: shots are taken here, and written by others meanwhile."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Final, cast

from acquisition._engine.agenda import Agenda
from acquisition._engine.hooks import Hooks
from acquisition._engine.references import References, quality_of
from acquisition._engine.rejection import SeenLight, rejection
from acquisition._engine.stop_request import StopRequest
from acquisition._engine.write_queue import Turn, WriteQueue
from acquisition._errors import DataError
from acquisition._pixels.quality import FrameQuality, above_dark
from acquisition._plan.plan import CapturePlan
from acquisition._plan.planned_shot import PlannedShot, ShotKey
from acquisition._session.frame_proofs import CHECKING
from acquisition._session.journal import Echo, FrameLine
from acquisition._session.layout import WRITERS
from acquisition._session.light_proof import BOARD, RIG, wrong_light
from acquisition._session.writer import SessionWriter
from rig import FrameLostError, FrameTimeoutError, Rig, RigError, Shot

# Frames that may wait for the disk, beside those in the camera's buffers.
ROOM: Final = 5
# Two: while one waits for the disk to flush, the other computes.
THREADS: Final = WRITERS
# How often a shot is taken again whose frame was lost, whatever the plan says: the object and the
# light have nothing to do with it.
LOST_RETAKES: Final = 3
# How often is looked whether a check is done or Ctrl-C was pressed.
_LOOK_S: Final = 0.2


class StoppedError(KeyboardInterrupt):
    """Ctrl-C was pressed once: the last shot is whole, and the disk may finish."""


@dataclass(frozen=True)
class Stored:
    """A frame that is on disk, and why it does not count, if so."""

    shot: PlannedShot
    line: FrameLine
    rejected: RigError | DataError | None


class Recording:
    """Takes the shots that a session is missing.

    Parameters
    ----------
    rig
        Open rig.
    writer
        The session.
    plan
        Its plan.
    queue
        For what is to be written.
    hooks
        Who is told.
    references
        What was recorded before tells.
    """

    def __init__(
        self,
        rig: Rig,
        writer: SessionWriter,
        plan: CapturePlan,
        queue: WriteQueue[Stored | None],
        hooks: Hooks,
        references: References,
    ) -> None:
        self._rig = rig
        self._writer = writer
        self._plan = plan
        self._queue = queue
        self._hooks = hooks
        self._references = references
        # Exposures of which a frame is kept that shows no light, so short it is.
        self._unseen_us: set[float] = set()
        self._todo = Agenda(writer.missing)
        self._total = writer.demanded
        self._done = self._total - len(self._todo)
        self._failures: Counter[ShotKey] = Counter()
        self._losses: Counter[ShotKey] = Counter()
        # A frame has come: where none has, the trigger may lack its wire.
        self._delivered = False
        self._sequenced = plan.sequence and rig.config.trigger == "board"
        self._card_is_there = False
        self._damaged: set[int] = set()

    def run(self, stop: StopRequest) -> None:
        """Take every shot, and wait until each is safe.

        Raises
        ------
        StoppedError
            When ``stop`` was asked for and shots are left.
        RigError, DataError, StorageError
            If a shot cannot be taken, is rejected too often, or cannot be written.
        """
        if self._plan.sequence and not self._sequenced:
            trigger = self._rig.config.trigger
            self.event("not_sequenced", reason=f"the rig file says trigger = {trigger!r}")
        while self._todo or not self._queue.settled:
            if not self._todo:
                self._queue.drain()
            self.collect()
            if stop.asked and self._todo:
                raise StoppedError("stopped by Ctrl-C after a shot")
            if self._queue.full:
                self._pause()
            elif self._todo:
                self._take(stop)

    def wait_for_checks(self, stop: StopRequest) -> None:
        """Wait until the frames of earlier processes were read back, which writers do when idle.

        Raises
        ------
        StoppedError
            When ``stop`` was asked for meanwhile.
        DataError
            If one is damaged.
        StorageError
            If the disk does not answer.
        """
        while not self._queue.rests(_LOOK_S):
            self._tell_of_damage()
            self._hooks.on_progress(CHECKING, *self._writer.checked)
            if stop.asked:
                raise StoppedError("stopped by Ctrl-C while earlier frames were checked")
        self._tell_of_damage()
        self._writer.check_undamaged()

    def _tell_of_damage(self) -> None:
        for damage in self._writer.damage:
            if damage.frame.line.seq not in self._damaged:
                self._damaged.add(damage.frame.line.seq)
                if self._hooks.on_damage is not None:
                    self._hooks.on_damage(damage.text)

    def collect(self) -> None:
        """Tell of what was written since, and let rejected shots be taken again."""
        self._tell_of_damage()
        for stored in self._queue.results():
            if stored is None:
                continue
            if stored.rejected is not None:
                self._failed(stored.shot, stored.rejected)
                self._todo.again(stored.shot)
                continue
            self._done += 1
            self._look_at_light(stored)
            if self._hooks.on_frame is not None:
                self._hooks.on_frame(stored.line)
            self._hooks.on_progress("recording", self._done, self._total)

    def _look_at_light(self, stored: Stored) -> None:
        """Remember what an LED gave, and tell of the first of an exposure that shows nothing."""
        shot = stored.shot
        if shot.lit_led is None or self._references.note(shot, quality_of(stored.line)):
            return
        exposure_us = _exposure_us(shot)
        if exposure_us not in self._unseen_us:
            self._unseen_us.add(exposure_us)
            self.event("no_light_seen", led=shot.lit_led, exposure_us=exposure_us)

    def event(self, name: str, **details: Any) -> None:
        """Have an event written in its turn, and tell of it."""
        self._queue.put(partial(self._write_event, name, details))
        if self._hooks.on_event is not None:
            self._hooks.on_event(name, details)

    def _take(self, stop: StopRequest) -> None:
        first = self._todo.first
        if first.role == "flat" and not self._card_is_there:
            self._rig.off()
            if not self._queue.settled:
                # A shot that is rejected yet is taken before the card hides the object.
                self._queue.drain()
                return
            if self._hooks.before_flats is not None:
                self._hooks.before_flats()
            if stop.asked:
                return
            self._card_is_there = True
        known = self._dark_is_known(first) and self._longer_is_known(first)
        if not known and not self._queue.settled:
            self._queue.drain()
        elif self._sequenced:
            self._take_many(stop)
        else:
            self._take_one()

    @property
    def _has_darks(self) -> bool:
        return self._plan.dark or self._plan.ambient

    def _dark_is_known(self, shot: PlannedShot) -> bool:
        """Tell whether the dark frame that a shot is judged by is known, where there is one."""
        unjudged = shot.lit_led is None or not self._has_darks
        return unjudged or self._references.dark(shot) is not None

    def _longer_is_known(self, shot: PlannedShot) -> bool:
        """Tell whether it is known what its LED gave at a longer exposure, where there is one."""
        if shot.lit_led is None or not self._has_darks or self._references.light(shot) is not None:
            return True
        brackets = range(len(self._plan.exposures_us))
        longest_us = max(self._plan.exposure_us(shot.lit_led, bracket) for bracket in brackets)
        return _exposure_us(shot) >= longest_us

    def _take_one(self) -> None:
        planned = self._todo.first
        try:
            shot = self._rig.shoot(planned.lit_led, _exposure_us(planned), self._plan.gain_db)
        except RigError as error:
            self._failed(planned, error)
        else:
            if self._is_of(planned, shot):
                self._todo.take()
                self._keep(planned, shot)

    def _take_many(self, stop: StopRequest) -> None:
        """Take all shots that one sequence can hold, or as many as the disk has room for."""
        first = self._todo.first
        group = self._todo.take(lambda shot: self._may_follow(first, shot))
        leds = [shot.lit_led for shot in group]
        shots = self._rig.sequence(leds, _exposure_us(first), self._plan.gain_db)
        with closing(cast(Generator[Shot, None, None], shots)) as sequence:
            while (shot := self._next(sequence, group)) is not None:
                if not self._is_of(group[0], shot):
                    break
                counts = self._keep(group.popleft(), shot)
                self.collect()
                if group and (stop.asked or self._queue.full or not counts):
                    break
        self._todo.put_back(group)

    def _may_follow(self, first: PlannedShot, shot: PlannedShot) -> bool:
        """Tell whether a shot may be of one sequence with its first: it can be judged by then."""
        flats = first.role == "flat", shot.role == "flat"
        if shot.exposure_us != first.exposure_us or flats[0] != flats[1]:
            return False
        # Dark frames are looked at as they come.
        dark = first.lit_led is None or self._dark_is_known(shot)
        return dark and self._longer_is_known(shot)

    def _next(self, sequence: Iterator[Shot], group: Sequence[PlannedShot]) -> Shot | None:
        try:
            return next(sequence, None)
        except RigError as error:
            self._failed(group[0], error)
            return None

    def _is_of(self, planned: PlannedShot, shot: Shot) -> bool:
        """Tell whether a frame was lit as planned; one that was not is noted, and not kept."""
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
        """Have a frame written; False where it is known by now that it does not count."""
        self._delivered = True
        quality, counts = None, True
        if planned.lit_led is None:
            # At once, as later frames are judged by it.
            quality = self._writer.measure(planned, shot.frame.pixels)
            counts = self._rejection(planned, quality) is None
            if counts:
                self._references.note(planned, quality)
        dark, light = self._references.dark(planned), self._references.light(planned)
        self._queue.put(partial(self._store, planned, shot, quality, dark, light))
        return counts

    def _pause(self) -> None:
        self._rig.off()
        self.event("paused", reason="frames wait for the disk", waiting=ROOM)
        began_s = time.monotonic()
        self._queue.wait_for_room()
        self.event("resumed", seconds=round(time.monotonic() - began_s, 3))

    def _failed(self, shot: PlannedShot, error: RigError | DataError) -> None:
        """Note that a shot has to be taken again, or raise the error."""
        failed, most = self._failures, self._plan.retakes
        if isinstance(error, FrameLostError):
            self.event("frames_lost", file=shot.file, led=shot.lit_led, **error.counts)
            failed = self._losses
            if self._came(error):
                most = max(most, LOST_RETAKES)
        failed[shot.key] += 1
        failures = failed[shot.key]
        if failures > most:
            if failures > 1:
                error.add_note(f"{shot.file} was taken {failures} times")
            raise error
        self.event("retake", file=shot.file, led=shot.lit_led, reason=str(error), failures=failures)

    def _came(self, error: FrameLostError) -> bool:
        """Tell whether frames come at all, so that only some were lost."""
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
        rejected = self._rejection(planned, quality, dark, light)
        line = self._writer.write_frame(
            planned,
            frame.pixels,
            exposure_us=frame.exposure_us,
            gain_db=frame.gain_db,
            frame_id=frame.frame_id,
            timestamp_ns=frame.timestamp_ns,
            temperature_c=frame.temperature_c,
            echo=None if shot.echo is None else Echo(**asdict(shot.echo)),
            status="ok" if rejected is None else "rejected",
            quality=quality,
            above_dark=None if planned.lit_led is None else above_dark(quality, dark, range_dn),
            before_line=turn,
        )
        return Stored(planned, line, rejected)

    def _rejection(
        self,
        planned: PlannedShot,
        quality: FrameQuality,
        dark: FrameQuality | None = None,
        light: SeenLight | None = None,
    ) -> RigError | DataError | None:
        return rejection(
            planned,
            quality,
            dark=dark,
            seen=light,
            range_dn=self._references.range_dn,
            max_clipped_fraction=self._plan.max_clipped_fraction,
        )

    def _write_event(self, name: str, details: Mapping[str, Any], turn: Turn) -> None:
        turn()
        self._writer.write_event(name, **details)


def _exposure_us(shot: PlannedShot) -> float:
    if shot.exposure_us is None:
        raise DataError(f"{shot.file}: the plan gives no exposure")
    return shot.exposure_us
