"""A fake board and camera that a test controls, behind the real `Rig`."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from acquisition import CapturePlan, Labels, Session, record
from acquisition.session import EventLine
from acquisition.session import writer as _session_writer
from rig import Board, BoardError, CameraError, CameraFrame, CameraInfo, Rig, RigConfig
from rig.arrays import UInt16
from rig.board import BoardEcho, BoardIdentity
from rig.camera import Trigger
from rig.host import clock

LEDS = 6
PLAN = CapturePlan(
    repeat=False, leds=(3, 0, 5), exposures_us=(200.0, 50.0), ambient=True, gain_db=2.0
)
LABELS = Labels("Ada", "coin")


def seen(led: int | None, exposure_us: float, albedo: float = 1.0, room: float = 0.0) -> UInt16:
    """Return the frame of the camera: a ramp that grows with LED number and exposure, up to 4095.

    ``room`` is the light of the room in units of the light of the first LED.
    """
    level = (room + (0 if led is None else led + 1)) * exposure_us * albedo
    ramp = 64 + level * np.linspace(1, 4, 10)[None, :] * np.ones((7, 1))
    return np.minimum(ramp, 4095).astype(np.uint16)


class Bench:
    """Board and camera in one: the LED that is on, a log, and planned failures."""

    port = "fake"
    identity = BoardIdentity("fake-board", 2, "1.2.3", LEDS, 10_000, 1000, 48)
    info = CameraInfo("Maker", "Eye", "42", 10, 7, "Mono12", 12, None, 10.0, 1e6)

    def __init__(self) -> None:
        self.led: int | None = None
        self.commands = 0
        self.frames = 0
        self.shots: list[int | None] = []
        self.on_trigger: Callable[[int], None] = lambda number: None
        self.off_fails = False
        self.dead: set[int] = set()
        self.albedo = 1.0
        self.room = 0.0
        self.exposure_us = 0.0
        self.gain_db = 0.0
        self.log: list[str] = []

    def on(self, led: int, hold_ms: float) -> BoardEcho:
        self.led = led
        self.commands += 1
        self.log.append("on")
        return BoardEcho(self.commands, led)

    def off(self) -> BoardEcho:
        if self.off_fails:
            raise BoardError("fake: OFF is not answered")
        was_on, self.led = self.led, None
        self.commands += 1
        self.log.append("off")
        return BoardEcho(self.commands, was_on)

    def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> float:
        # Like a camera, use the nearest supported step.
        self.exposure_us, self.gain_db = exposure_us + 0.25, gain_db
        return self.exposure_us

    def trigger(self) -> int:
        self.frames += 1
        self.shots.append(self.led)
        self.on_trigger(self.frames)
        return self.frames

    def fetch(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None = None
    ) -> CameraFrame:
        led = None if self.led in self.dead else self.led
        pixels = seen(led, self.exposure_us - 0.25, self.albedo, self.room)
        return CameraFrame(pixels, frame_id, 1000, self.exposure_us, self.gain_db, 41.5)

    def unplug_at(self, number: int) -> None:
        """Let the camera fail at a given frame."""

        def unplug(frame: int) -> None:
            if frame == number:
                raise CameraError("the camera was unplugged")

        self.on_trigger = unplug

    def expect(self) -> int:
        raise CameraError("fake: has no trigger line")

    def darken(self) -> None: ...
    def ping(self) -> None: ...
    def arm(self, trigger: Trigger = "software") -> None: ...
    def disarm(self) -> None: ...
    def close(self) -> None: ...


def rig_on(bench: Bench, **config: Any) -> Rig:
    """Open a rig on a bench; LED 4 is listed as dead."""
    values = {"name": "bench-1", "driver": "fake", "leds": LEDS, "settle_ms": 0, "dead_leds": (4,)}
    return Rig(cast(Board, bench), bench, RigConfig(**{**values, **config}))


def events_of(session: Session) -> list[EventLine]:
    """Return the events except pauses: the fake camera is faster than any disk."""
    return [line for line in session.events if line.event not in ("paused", "resumed")]


def cut(
    rig: Rig, bench: Bench, folder: Path, at: int, plan: CapturePlan = PLAN, **options: Any
) -> Path:
    """Record until the camera fails at a given frame."""
    bench.unplug_at(at)
    with pytest.raises(CameraError):
        record(rig, plan, folder, LABELS, **options)
    bench.on_trigger = lambda number: None
    bench.shots.clear()
    return folder


def flip(path: Path) -> None:
    """Change the last bit of the last sample."""
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))


class Gate:
    """A disk that blocks all writes until the gate is opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.open = threading.Event()
        real = _session_writer.store_frame

        def slow(path: Path, pixels: UInt16) -> Any:
            ends_s = clock.monotonic() + 60
            while not self.open.is_set():
                assert clock.monotonic() < ends_s
                clock.sleep(0.02)
            return real(path, pixels)

        monkeypatch.setattr(_session_writer, "store_frame", slow)
