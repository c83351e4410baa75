"""Benches for comparing cameras, on which tests turn LEDs on and pulse the trigger line."""

import queue

import numpy as np
import pytest

import rig.genicam.camera
import rig.genicam.isolated
from acquisition import NoiseModel
from rig.genicam import IsolatedCamera, open_genicam, open_isolated
from rig.host import clock
from simulator.bench import BenchState, BenchWriter
from simulator.camera import GentlCamera, ImageFormation, VirtualCamera
from simulator.gentl import CompilerError
from tests.simulator.camera_options import grouped

SIZE = (6, 10)
LEDS = 12
BLACK = 20
EXPOSURE_US = 1000.0
# One electron per grey value and no noise: the grey value of a frame identifies its LED.
NOISE = NoiseModel(1.0, 0.0, float(BLACK), 12)


def plane(led):
    """Return the electrons per microsecond under an LED, so that `grey` is exact."""
    return np.full(SIZE, 0.0 if led is None else (led + 1) / 10, np.float32)


def grey(led, exposure_us=EXPOSURE_US):
    """Return the value of every pixel after an exposure under an LED."""
    return BLACK + (led + 1) * exposure_us / 10


class Bench:
    """A light, a trigger line, and a camera that sees them."""

    def __init__(self, folder):
        self.path = folder / "bench.state"
        self.writer = BenchWriter(self.path)
        self._opened = []

    def light(self, led):
        """Turn one LED on from now on."""
        now = clock.monotonic_ns()
        self.writer.put_out(now)
        self.writer.light(led, now, now + 60 * 10**9)

    def dark(self):
        self.writer.put_out(clock.monotonic_ns())

    def pulse(self, after_s=0.0):
        """Pulse the trigger line and return the time, in nanoseconds of the monotonic clock."""
        time_ns = clock.monotonic_ns() + round(after_s * 1e9)
        self.writer.pulse(time_ns)
        return time_ns

    def open(self, **options):
        camera = self._open(**options)
        self._opened.append(camera)
        return camera

    def close(self):
        for camera in self._opened:
            camera.close()
        self.writer.close()


class InsideBench(Bench):
    """The camera inside the process, which may be in a world."""

    def __init__(self, folder):
        super().__init__(folder)
        self._faults = {}

    def fault(self, frame, kind, late_s=0.0):
        """Let a fault occur with a frame; late frames arrive when they are fetched again."""
        self._faults[frame] = kind
        for camera in self._opened:
            camera.faults[frame] = kind

    def _open(self):
        return VirtualCamera(
            plane,
            size=SIZE,
            bench=BenchState(self.path),
            name="c7",
            faults=self._faults,
            formation=ImageFormation(NOISE, noisy=False),
        )


class GenICamBench(Bench):
    """The camera behind a GenTL producer and harvesters."""

    def __init__(self, folder, **options):
        super().__init__(folder)
        options = {"planes": plane, "size": SIZE, "leds": LEDS, "noise": NOISE, **options}
        try:
            self.device = GentlCamera(
                options.pop("planes"),
                **grouped(bench_state_path=self.path, noisy=False, serial="c7", **options),
            )
        except CompilerError as error:
            pytest.skip(str(error))

    def fault(self, frame, kind, late_s=0.0):
        self.device.set_fault(frame, kind, late_ms=late_s * 1000)

    def _open(self, **options):
        return open_genicam(self.device.cti, **options)

    def close(self):
        super().close()
        self.device.close()


class IsolatedBench(GenICamBench):
    """The same camera, operated by another process."""

    def _open(self, **options):
        return open_isolated(self.device.cti, **options)


class AwaitedTime:
    """A module ``time`` and replies of a process, where only what a caller waits for takes time.

    So the computer may be busy. A caller who waits for a second really waits for a part of it.

    Parameters
    ----------
    monkeypatch
        Makes it the time of GenICam cameras.
    speed
        Seconds that pass in a second of real time.
    """

    def __init__(self, monkeypatch, speed):
        self._speed = speed
        self._monkeypatch = monkeypatch
        self.now_s = 0.0
        for module in (rig.genicam.camera, rig.genicam.isolated):
            monkeypatch.setattr(module, "time", self)

    def of(self, camera):
        """Apply it to the replies of a camera in another process too."""
        if isinstance(camera, IsolatedCamera):
            self._replies, self.put = camera._replies, camera._replies.put
            self._monkeypatch.setattr(camera, "_replies", self)
        return self

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        clock.sleep(seconds / self._speed)
        self.now_s += seconds

    def get(self, timeout):
        try:
            return self._replies.get(timeout=timeout / self._speed)
        except queue.Empty:
            self.now_s += timeout
            raise
