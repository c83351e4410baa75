"""A world: a disk, a board, a camera and programs that share one virtual time."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from inspect import isfunction
from pathlib import Path
from typing import Any, Literal, cast

from rig import CameraError, RigConfig, Shot
from rig.board import Board
from rig.host import clock, filesystem, lines, program, threads
from rig.shooting import lights_off
from simulator.camera.sensor import ImageFormation
from simulator.led_board.faults import BoardFault, FaultKind
from simulator.scene.rig_scenes import bench_sensor
from simulator.world.camera import CameraFault, WorldCamera
from simulator.world.disk import Disk, DiskFault
from simulator.world.line import WorldBoard, WorldLine
from simulator.world.rig import WatchedRig
from simulator.world.schedule import MOST, Event, Schedule
from simulator.world.scheduler import (
    Condition,
    KilledError,
    Lock,
    Program,
    Scheduler,
    Thread,
    replaced,
)

_DAY = datetime(2026, 1, 1, tzinfo=UTC)
# How often an operator frees too little space.
_TOO_LITTLE = 0.5
# Packages whose code may not use real time in a world.
_OURS = ("rig", "acquisition", "simulator", "tests")


class RealTimeError(AssertionError):
    """Code in a world used the time of the operating system."""


class World:
    """Everything that a recording touches, driven by one schedule.

    Parameters
    ----------
    schedule
        Seed and faults.
    folder
        Empty folder: its ``disk`` is the disk of the world.
    leds
        Number of LEDs of the rig.
    trigger
        What triggers the camera.
    wired
        Whether the camera's exposure-active output reaches the board.
    formation
        How images form; that of the bench by default.
    log
        Receives a line for each step; None for no log.

    Attributes
    ----------
    camera_faults
        Faults by frame id of the cameras that are opened from now on.
    met
        The faults that have happened.
    powered
        Whether the power held until the end of the last program.
    second
        Starts the program of a second operator; None for none.
    shots
        Shots that its rigs have returned.
    """

    def __init__(
        self,
        schedule: Schedule,
        folder: Path,
        *,
        leds: int = 6,
        trigger: Literal["software", "board"] = "software",
        wired: bool = True,
        formation: ImageFormation | None = None,
        log: Callable[[str], None] | None = None,
    ) -> None:
        self.schedule = schedule
        self.leds = leds
        self.scheduler = Scheduler(schedule.seed, self._step)
        (folder / "disk").mkdir()
        self.disk = Disk(
            folder / "disk",
            self.scheduler.random,
            self.scheduler.step,
            self._pause,
            lambda: self.scheduler.program,
        )
        self.board = WorldBoard(self.scheduler, leds, wired=wired)
        self.camera: WorldCamera | None = None
        self.camera_faults: dict[int, CameraFault] = {}
        self._camera_back_ns = 0
        self._formation = formation or ImageFormation(bench_sensor())
        self.config = RigConfig(
            name="world",
            driver="world",
            leds=leds,
            trigger=trigger,
            frame_timeout_s=1.0,
        )
        self.met: list[Event] = []
        self.second: Callable[[], object] | None = None
        self.shots: list[Shot] = []
        self._left: list[Event] = []
        self._later = list(schedule.events)
        self._programs = 0
        self._log = log
        self._clock_off = timedelta()
        self.powered = True
        self.damaged: set[str] = set()

    def run(self, name: str, main: Callable[[], object]) -> Program:
        """Run a program in the world to its end, or until it or the power is gone."""
        self._begin()
        try:
            with self._installed():
                return self.scheduler.run(name, main)
        finally:
            self._end()

    @contextmanager
    def inside(self) -> Iterator[None]:
        """Make the calling thread a program of the world in the block, as a fixture needs it."""
        self._begin()
        try:
            with self._installed(), self.scheduler.inside("block"):
                yield
        finally:
            self._end()

    def open_rig(self) -> WatchedRig:
        """Open the rig of the world; to be called in it."""
        board = Board(self.board.port)
        try:
            rig = WatchedRig(board, self.open_camera(), self.config, open_camera=self.open_camera)
        except BaseException:
            board.close()
            raise
        rig.shots = self.shots
        return rig

    def open_camera(self) -> WorldCamera:
        """Open the camera; to be called in the world."""
        self.scheduler.step("open the camera")
        if self.scheduler.now_ns < self._camera_back_ns:
            raise CameraError("no camera found")
        self.camera = WorldCamera(self.leds, self.board.view, self._formation, self.camera_faults)
        return self.camera

    def unplug_camera(self, away_s: float) -> None:
        """Unplug the camera now, and plug it in again after this time."""
        self._camera_back_ns = self.scheduler.now_ns + round(away_s * 1e9)
        if self.camera is not None:
            self.camera.unplug()

    def unplug_board(self, away_s: float) -> None:
        """Unplug the board now, and plug it in again after this time, on a port of another name."""
        self.board.unplug(round(away_s * 1e9), f"world-{self.board.plugs}")

    def connect(self, leds: int) -> None:
        """Replace the board by another one, which starts now."""
        self.board = WorldBoard(self.scheduler, leds)

    def settle(self, seconds: float) -> None:
        """Let time pass without any program, so that the board does what it does alone."""
        scheduler = self.scheduler
        end_ns = scheduler.now_ns + round(seconds * 1e9)
        while scheduler.now_ns < end_ns:
            scheduler.now_ns = max(scheduler.now_ns + 1, min(end_ns, self.board.due_ns))
            self.board.advance()

    def repair(self) -> None:
        """Let the operator repair disk, board and camera between two programs."""
        generator = self.scheduler.random
        if self.disk.repair() and generator.random() < _TOO_LITTLE:
            event = Event(0, "disk:full", generator.randint(1, MOST), self._programs)
            self._later.append(event)
        self.board.repair()
        self._camera_back_ns = 0

    def forget_events(self) -> None:
        """Remove the faults that have not happened yet."""
        self._left.clear()
        self._later.clear()

    def say(self, line: str) -> None:
        """Write a line to the log."""
        if self._log is not None:
            at = f"{self.scheduler.now_ns / 1e9:12.6f} s  {self.scheduler.steps:6d}"
            self._log(f"{at}  {line.replace(str(self.disk.root), '')}")

    def _step(self, name: str) -> None:
        task = self.scheduler.current
        if self._log is not None and task is not None:
            self.say(f"{task.name}: {name}")
        due = [event for event in self._left if event.step <= self.scheduler.steps]
        for event in (one for one in due if name == "fsync" or not one.flush):
            self._left.remove(event)
            self.met.append(event)
            self.say(f"*** {event.kind} {event.value}")
            self._happen(event)

    def _happen(self, event: Event) -> None:
        """Let a fault happen."""
        place, _, kind = event.kind.partition(":")
        value, scheduler = event.value, self.scheduler
        # Some stay away for longer than a recording waits.
        away_s = value / 8
        if kind == "brown-out":
            self.board.reset()
        elif event.kind == "camera:away":
            self.unplug_camera(away_s)
        elif event.kind == "board:away":
            if value % 2:  # it has no other supply
                self.board.reset()
            self.unplug_board(away_s)
        elif place == "board":
            # An LED; milliseconds that are about those of a shot; others are plausible as they are.
            most = {"wrong-led": self.leds, "goes-dark": 30}.get(kind, value + 1)
            verbs = {"wrong-led": ("FLASH", "STEP"), "goes-dark": ("FLASH", "RUN")}.get(kind)
            if verbs is not None and self.config.trigger == "software":
                verbs = ("ON", "ON")
            verb = verbs and verbs[value // 30 % 2]
            fault = BoardFault(kind=cast(FaultKind, kind), verb=verb, value=value % most)
            self.board.add_fault(fault)
        elif kind == "stray-trigger":
            self.board.history.disturb(scheduler.now_ns + value * 100_000)
        elif kind == "garbage":
            self.board.garbage(scheduler.random.randbytes(value % 40 + 1))
        elif kind == "delay":
            self.board.extra_ns = value * 1_000_000 if self.board.extra_ns == 0 else 0
        elif kind == "split":
            self.board.splits += value
        elif place == "lamp" and self.camera is not None:
            self.camera.dark = value % 3 + 1
        elif place == "camera" and self.camera is not None:
            self.camera.fault = cast(CameraFault, kind)
        elif kind in ("rot", "lost-file"):
            self._damage(value, lost=kind == "lost-file")
        elif place == "disk":
            self.disk.faults[cast(DiskFault, kind)] = {"full": 30 * value, "slow": value / 8}.get(
                kind, 1
            )
        elif kind == "busy":
            scheduler.stall(value / 100)
        elif kind == "clock-step":
            self._clock_off += timedelta(minutes=value - 150)
        elif kind == "power-loss":
            self.powered = False
            for one in self._running():
                scheduler.kill(one)
        elif kind == "second" and self.second is not None:
            scheduler.start("second", self.second)
        elif place == "program":
            for one in self._running()[:1]:
                if kind == "SIGKILL":
                    scheduler.kill(one)
                else:
                    one.pending.append(getattr(signal, kind))

    def _begin(self) -> None:
        """Make ready for a program, and for the faults that wait for its start."""
        self.powered = True
        now = [event for event in self._later if event.after == self._programs]
        self._later = [event for event in self._later if event.after != self._programs]
        began = self.scheduler.steps
        self._left += [replace(event, step=began + event.step) for event in now]
        self._left.sort(key=lambda event: event.step)
        self._programs += 1

    def _end(self) -> None:
        """Clean up after the last program."""
        self.disk.close_all()
        lights_off.watched.clear()
        if not self.powered:
            self.disk.power_loss()

    def _running(self) -> list[Program]:
        return list(dict.fromkeys(task.program for task in self.scheduler.tasks))

    def _damage(self, value: int, *, lost: bool) -> None:
        frames = sorted(self.disk.root.glob("*/frames/[!.]*"))
        if frames:
            path = frames[value % len(frames)]
            self.say(f"damage {path.name}")
            self.damaged.add(path.name)
            if lost:
                self.disk.lose(path)
            else:
                self.disk.rot(path, self.scheduler.random.randrange(10**6))

    def _pause(self, seconds: float) -> None:
        scheduler = self.scheduler
        scheduler.wait(lambda: False, scheduler.now_ns + round(seconds * 1e9))

    @contextmanager
    def _installed(self) -> Iterator[None]:
        scheduler, disk = self.scheduler, self.disk
        own: list[tuple[object, str, object]] = [
            (clock, "monotonic", self._monotonic),
            (clock, "monotonic_ns", self._monotonic_ns),
            (clock, "sleep", self._sleep),
            (clock, "utc_now", self._utc_now),
            (threads, "Thread", partial(Thread, scheduler)),
            (threads, "Lock", partial(Lock, scheduler)),
            (threads, "Condition", partial(Condition, scheduler)),
            (threads, "is_main", self._is_main),
            (program, "draw_below", scheduler.random.randrange),
            (program, "handle", self._handle),
            (program, "handler_of", self._handler_of),
            (program, "at_exit", self._at_exit),
            (program, "not_at_exit", self._not_at_exit),
            (program, "send_to_itself", self._send_to_itself),
            (lines, "open_line", self._open_line),
            (lines, "ports", self._ports),
        ]
        changes = [name for name, one in vars(filesystem).items() if isfunction(one)]
        own += [(filesystem, name, getattr(disk, name)) for name in changes]
        own += [
            (time, name, self._refused(name)) for name in ("sleep", "monotonic", "monotonic_ns")
        ]
        with ExitStack() as stack:
            stack.enter_context(replaced(*own))
            yield

    def _refused(self, name: str) -> Callable[..., Any]:
        """Return a function of `time` that our code must not call in a world."""
        real = getattr(time, name)

        def checked(*arguments: Any) -> Any:
            caller = str(sys._getframe(1).f_globals.get("__name__", ""))  # noqa: SLF001
            if caller.partition(".")[0] in _OURS and self.scheduler.is_inside():
                raise RealTimeError(f"{caller} calls time.{name}: use rig.host.clock")
            return real(*arguments)

        return checked

    def _monotonic(self) -> float:
        self.scheduler.step("time")
        return self.scheduler.now_ns / 1e9

    def _monotonic_ns(self) -> int:
        self.scheduler.step("time")
        return self.scheduler.now_ns

    def _sleep(self, seconds: float) -> None:
        self.scheduler.step("sleep")
        self._pause(seconds)

    def _utc_now(self) -> datetime:
        self.scheduler.step("time of day")
        return _DAY + self._clock_off + timedelta(microseconds=self.scheduler.now_ns // 1000)

    def _is_main(self) -> bool:
        task = self.scheduler.current
        return task is not None and task.main

    def _handlers(self) -> dict[int, Any]:
        running = self.scheduler.program
        if running is None or running.dead:
            raise KilledError
        return running.handlers

    def _handle(self, number: int, handler: object) -> object:
        before = self._handlers().get(number, signal.SIG_DFL)
        self._handlers()[number] = handler
        return before

    def _handler_of(self, number: int) -> object:
        return self._handlers().get(number, signal.SIG_DFL)

    def _at_exit(self, function: Callable[..., object]) -> Callable[..., object]:
        running = self.scheduler.program
        if running is not None:
            running.at_exit.append(function)
        return function

    def _not_at_exit(self, function: Callable[..., object]) -> None:
        running = self.scheduler.program
        if running is not None and function in running.at_exit:
            running.at_exit.remove(function)

    def _send_to_itself(self, number: int) -> None:
        running = self.scheduler.program
        if running is not None:
            running.pending.append(number)

    def _ports(self) -> dict[str, str]:
        return {self.board.port: self.board.port} if self.board.present else {}

    def _open_line(self, port: str, *_: object, timeout: float | None = None, **__: object) -> Any:
        return WorldLine(self.scheduler, self.board, port, timeout=timeout)
