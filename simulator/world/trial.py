"""One recording in a world, which an operator starts again until it is complete."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import partial
from itertools import chain
from pathlib import Path

import numba

from acquisition import (
    CapturePlan,
    DataError,
    Labels,
    MissingPathError,
    StorageError,
    record,
    resume,
)
from acquisition.engine.recording_loop import RecordingHooks
from acquisition.session import SessionWriter, verify_session
from acquisition.session.journal import Echo, FrameLine
from rig import RigError
from rig.host import clock
from simulator.scene.rig_scenes import bench_sensor
from simulator.world.camera import led_of
from simulator.world.invariants import (
    SessionState,
    badly_lit,
    lit_after,
    lost,
    misplaced,
    shot_of,
    wrong_frames,
)
from simulator.world.schedule import Event, Schedule
from simulator.world.scheduler import Program, StuckError
from simulator.world.world import World

LEDS = 6
PLAN = CapturePlan(leds=tuple(range(LEDS)), exposures_us=(4000.0, 16_000.0), retakes=3)
_SEQUENCED = PLAN.model_copy(update={"sequence": True})
_MEMORY = Path("/dev/shm")  # files in memory, where the system has it
# Programs that an operator starts; nothing happens during the last one.
_MOST_PROGRAMS = 30
# A command that is on its way, and the board's watchdog.
_DARK_AFTER_NS = 1_500_000_000
# A second operator waits at most so long for the first one.
_PATIENCE_S = 3.0
# How often an operator resumes with a program of his own; the share of frames that it keeps.
_BY_HAND, _KEPT = 0.5, 0.8
_SETTLES_S = 3.0
# Errors that a program may end with: each is one line for the operator.
_INCONSISTENT = "take them before completing"
_EXPECTED = (RigError, DataError, StorageError, KeyboardInterrupt, SystemExit)


@dataclass(frozen=True)
class Outcome:
    """Result of a trial.

    Parameters
    ----------
    schedule
        What was drawn.
    violations
        One line for each promise that was broken.
    met
        Faults that happened.
    programs
        Number of programs until the session was complete.
    steps
        Number of steps of the world.
    ended_s
        Virtual time, seconds.
    seconds
        Real time of each part.
    """

    schedule: Schedule
    violations: tuple[str, ...]
    met: tuple[Event, ...]
    programs: int
    steps: int
    ended_s: float
    seconds: dict[str, float]


class Trial:
    """Runs a schedule and checks every promise.

    Parameters
    ----------
    schedule
        Seed and faults.
    folder
        Empty folder.
    log
        Receives a line for each step; None for no log.
    """

    def __init__(
        self, schedule: Schedule, folder: Path, log: Callable[[str], None] | None = None
    ) -> None:
        # Sequences, flashes and single shots, with and without the wire from camera to board.
        way = schedule.seed % 3
        self._plan = _SEQUENCED if way == 0 else PLAN
        self.world = World(
            schedule,
            folder,
            leds=LEDS,
            trigger="software" if way == 2 else "board",
            wired=schedule.seed % 2 == 1,
            log=log,
        )
        self.world.second = self._second
        self.session = self.world.disk.root / "owl"
        self._black = bench_sensor().black_level_dn
        self._reported: list[tuple[int, str]] = []
        self._found: list[str] = []
        self._seconds: defaultdict[str, float] = defaultdict(float)

    def run(self) -> Outcome:
        """Record until the session is complete; return what was found."""
        programs = 0
        state = SessionState.read(self.session)
        kernel_threads = numba.get_num_threads()
        numba.set_num_threads(1)  # starting threads takes longer than a small frame
        try:
            while programs < _MOST_PROGRAMS:
                if programs == _MOST_PROGRAMS - 1:
                    self.world.forget_events()
                met, before = len(self.world.met), state
                with self._timed("programs"):
                    ended = self.world.run(f"program {programs}", self._program(before))
                with self._timed("checks of light and files"):
                    self._check_end(ended)
                    state = SessionState.read(self.session)
                    self._check_disk(before, state, ended)
                with self._timed("verify"):
                    if state.lines:
                        self._check_verify(state, ended)
                programs += 1
                if state.complete and not state.damaged:
                    break
                if len(self.world.met) == met:
                    self._note(f"without a fault, {ended.name} ended with {ended.error!r}")
                    break
                self.world.repair()
        except StuckError as error:
            self._note(str(error))
        finally:
            numba.set_num_threads(kernel_threads)
        world = self.world
        return Outcome(
            world.schedule,
            tuple(dict.fromkeys(self._found)),
            tuple(world.met),
            programs,
            world.scheduler.steps,
            world.scheduler.now_ns / 1e9,
            dict(self._seconds),
        )

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        began_s = time.perf_counter()
        yield
        self._seconds[part] += time.perf_counter() - began_s

    def _note(self, violation: str) -> None:
        self.world.say(f"VIOLATION {violation}")
        self._found.append(violation)

    def _program(self, state: SessionState) -> Callable[[], object]:
        """Return what the operator starts now."""
        if not state.lines:
            return self._record
        return partial(self._resume, retake_damaged=bool(state.damaged))

    def _record(self) -> None:
        with self.world.open_rig() as rig:
            if (self.session / "session.toml").exists():  # died before its first line
                resume(rig, self.session, hooks=self._hooks())
            else:
                record(rig, self._plan, self.session, Labels(operator="me"), hooks=self._hooks())

    def _resume(self, *, retake_damaged: bool) -> None:
        if not retake_damaged and self.world.scheduler.random.random() < _BY_HAND:
            with suppress(DataError):  # it may not complete without what it rejected
                self._by_hand()
                return
        with self.world.open_rig() as rig:
            resume(rig, self.session, retake_damaged=retake_damaged, hooks=self._hooks())

    def _hooks(self) -> RecordingHooks:
        return RecordingHooks(on_frame=self._safe, accept=lambda finding: True)

    def _safe(self, line: FrameLine) -> None:
        self._reported.append((line.seq, line.file_sha256))

    def _second(self) -> None:
        """Let a second operator resume the session."""
        generator = self.world.scheduler.random
        try:
            clock.sleep(max(0.0, generator.uniform(-_PATIENCE_S, _PATIENCE_S)))
            self._resume(retake_damaged=False)
        except (*_EXPECTED, MissingPathError) as error:
            self.world.say(f"second: {error}")
        except Exception as error:  # noqa: BLE001 - judged here
            self._note(f"second ended with {type(error).__name__}: {error}")

    def _by_hand(self) -> None:
        """Take the missing shots without the loop of a recording, and reject some of them."""
        with SessionWriter.reopen(self.session) as writer, self.world.open_rig() as rig:
            writer.write_event("second", operator="other")
            for planned in chain.from_iterable(writer.missing for _ in range(2)):
                shot = rig.shoot(planned.led, planned.exposure_us or 0.0)
                pixels = shot.frame.pixels
                writer.measure(planned, pixels)  # refuses a frame of another size
                echo = None if shot.echo is None else Echo(**asdict(shot.echo))
                keeps = self.world.scheduler.random.random() < _KEPT
                keeps = keeps and led_of(pixels, self._black) == planned.led
                store = partial(writer.write_frame, planned, pixels, echo=echo)
                with suppress(StorageError):  # the second time the disk may accept it
                    self._safe(store() if keeps else store(status="rejected"))
            writer.complete()

    def _check_end(self, ended: Program) -> None:
        error, world = ended.error, self.world
        unexpected = not isinstance(error, _EXPECTED) or _INCONSISTENT in str(error)
        if error is not None and unexpected:
            self._note(f"{ended.name} ended with {type(error).__name__}: {error}")
        world.say(f"{ended.name} ended: {error!r}" if error else f"{ended.name} ended")
        dark_ns = world.scheduler.now_ns
        if ended.killed or error is not None:
            dark_ns += _DARK_AFTER_NS
        world.settle(_SETTLES_S)
        lit = world.board.history.lit
        for text in (*lit_after(lit, dark_ns), *badly_lit(world.shots, lit)):
            self._note(f"{ended.name}: {text}")
        world.shots.clear()

    def _check_disk(self, before: SessionState, now: SessionState, ended: Program) -> None:
        texts = (
            *lost(self._reported, now),
            *misplaced(now),
            *wrong_frames(self.session, now, self._black),
            *self._unexpected(before, now),
            *(f"{name} replaced another frame" for name in self.world.disk.replaced),
        )
        for text in texts:
            self._note(f"{ended.name}: {text}")

    def _unexpected(self, before: SessionState, now: SessionState) -> Iterator[str]:
        """Yield what changed although it should not."""
        for old, new in zip(before.lines, now.lines, strict=False):
            if old != new:
                yield f"line {old['seq']} of the journal has changed"
        # What was not reported as safe may be lost with the power.
        if len(now.lines) < len(before.lines) and self.world.powered:
            yield "the journal has lost lines"
        damaged = {before.files.get(name) for name in self.world.damaged}
        if self.world.powered and (gone := before.kept - now.kept - damaged):
            yield f"{len(gone)} files of frames have disappeared"
        if now.complete and not before.complete and set(before.damaged) & set(now.damaged):
            yield "completed although a frame was damaged before"
        exposures = dict(enumerate(self._plan.exposures_us))
        for line in now.frames:
            if line["role"] == "light" and line["exposure_us"] != exposures[line["bracket"]]:
                yield f"{line['file']} was exposed for {line['exposure_us']} us"
        for file in now.damaged:
            if Path(file).name not in self.world.damaged:
                yield f"{file} is not what the journal describes"
        fresh = [one for one in now.frames if one["seq"] >= len(before.lines)]
        aside = now.set_aside - before.set_aside
        again = {shot_of(one) for one in before.frames if one["seq"] in aside}
        for line in fresh:
            if line["status"] == "ok" and shot_of(line) in before.taken - again:
                yield f"{line['file']} was taken again although its shot was there"

    def _check_verify(self, now: SessionState, ended: Program) -> None:
        """Compare what `verify_session` says with the state of the disk."""
        said = verify_session(self.session)
        if not self.world.damaged and said.problems:
            self._note(f"{ended.name}: verify finds {said.problems[0]}")
        if sorted(said.damaged) != sorted({Path(name).name for name in now.damaged}):
            self._note(
                f"{ended.name}: verify says {said.damaged} are damaged, they are {now.damaged}"
            )
        if said.complete != now.complete:
            self._note(f"{ended.name}: verify says complete = {said.complete}")
        missing = len({shot.key for shot in self._plan.shots()}) - len(now.taken)
        if len(said.missing) != missing:
            self._note(f"{ended.name}: verify misses {len(said.missing)} shots, it is {missing}")
        if now.complete and missing:
            self._note(f"{ended.name}: complete with {missing} shots missing")


@contextmanager
def empty_folder() -> Iterator[Path]:
    """Provide a folder, in memory if the system has it."""
    parent = _MEMORY if _MEMORY.is_dir() else None
    folder = Path(tempfile.mkdtemp(prefix="sgp-world-", dir=parent))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def run(schedule: Schedule, *, log: bool = False) -> Outcome:
    """Run one schedule."""
    with empty_folder() as folder:
        return Trial(schedule, folder, print if log else None).run()


def run_seed(seed: int) -> Outcome:
    """Run the schedule of a seed."""
    return run(Schedule.drawn(seed))
