"""A camera that sees the LEDs of the virtual board.

It runs in the host's process and implements `rig.Camera`; it is not a GenICam device.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Literal

from rig import CameraError, CameraFrame, CameraGoneError, CameraInfo, FrameTimeoutError
from rig.camera import Trigger
from rig.host import clock
from simulator.bench.state import BenchState
from simulator.bench.wiring import Planes
from simulator.camera.sensor import ImageFormation, pixel_format
from simulator.camera.virtual_sensor import Exposure, VirtualSensor
from simulator.scene.lens import CFAS

CameraFault = Literal["lost", "late", "unplug"]

EXPOSURE_MIN_US = 10.0
EXPOSURE_MAX_US = 10_000_000.0
GAIN_MAX_DB = 24.0
FRAME_PERIOD_US = 1000.0
LINE = "Line0"

_POLL_S = 0.001
_WAITING_EVERY_S = 0.1


class VirtualCamera:
    """A camera with a global shutter whose pixels collect the light of the bench state.

    A frame is the sensor's image of ``exposure * planes(None)`` plus, for every LED that was on
    during the exposure, ``planes(led)`` times the time that it was on. A frame therefore shows if
    it was taken under the wrong LED, or if the LED turned off too early. If the camera is armed for
    the line, it exposes at the trigger pulses of the bench state, and misses pulses during an
    exposure.

    All random values of a frame depend on the seed, the LED, the exposure time, the gain, and the
    number of equal shots before it; they do not depend on the order of the other shots. A shot does
    not count if its light was cut off before its frame was complete, because a busy host is slow.

    Parameters
    ----------
    planes
        Function that returns, for an LED, the ``(H, W)`` float32 photons per microsecond of its
        light alone (electrons if the quantum efficiency is 1); for None, those of the ambient
        light, which is always on. It is called while the LED is on and must return immediately:
        render the planes beforehand.
    size
        (H, W) of the planes.
    bench
        State of light and trigger line; closed with the camera.
    formation
        How the image forms from the light: sensor, lamps, colour filters.
    realtime
        If False, the camera does not wait for the exposure time to pass: the time between software
        trigger and fetch represents the exposure.
    name
        Serial number in ``info``.
    faults
        Faults by frame id: the frame is lost or late (it arrives after the timeout of its fetch),
        or the camera is unplugged instead of exposing.

    Raises
    ------
    CameraError
        If the formation's ``cfa`` or ``shake_px`` is invalid; from all methods once the camera is
        closed or unplugged.
    """

    def __init__(
        self,
        planes: Planes,
        *,
        size: tuple[int, int],
        bench: BenchState,
        formation: ImageFormation,
        realtime: bool = True,
        name: str = "virtual-camera",
        faults: Mapping[int, CameraFault] | None = None,
    ) -> None:
        cfa, shake_px = formation.cfa, formation.shake_px
        if cfa is not None and cfa not in CFAS:
            raise CameraError(f"camera {name}: cfa {cfa!r} is not one of {', '.join(CFAS)}")
        if not 0 <= shake_px < math.inf:
            raise CameraError(f"camera {name}: shake_px is {shake_px}, it must be 0 or more")
        self.info = CameraInfo(
            vendor="sgp",
            model="virtual camera",
            serial=name,
            width=size[1],
            height=size[0],
            pixel_format=pixel_format(cfa, formation.noise.bit_depth),
            bit_depth=formation.noise.bit_depth,
            cfa=cfa,
            exposure_min_us=EXPOSURE_MIN_US,
            exposure_max_us=EXPOSURE_MAX_US,
            frame_period_us=FRAME_PERIOD_US,
        )
        self.faults = dict(faults or {})
        self._bench = bench
        self._sensor = VirtualSensor(planes, self.info, bench, formation)
        self._realtime = realtime
        self._lamps_ns = 0
        self._exposure_us = 10_000.0
        self._gain_db = 0.0
        self._armed: Trigger | None = None
        self._closed = self._unplugged = False
        self._next_id = 0
        # The last fetch failed: exposures in progress are discarded before the next trigger.
        self._stale = False
        # The line has been read up to this time; the next pulse's frame has this id.
        self._pulses_ns = 0
        self._pulse_id = 0
        # Exposures whose frames have not been fetched, by frame id.
        self._started: dict[int, Exposure] = {}

    def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> float:
        """Set exposure time (in steps of 1 us) and gain for the next triggers."""
        self._check()
        if not EXPOSURE_MIN_US <= exposure_us <= EXPOSURE_MAX_US:
            raise CameraError(
                f"camera {self.info.serial}, ExposureTime: {exposure_us:g} us is outside its range "
                f"of {EXPOSURE_MIN_US:g} to {EXPOSURE_MAX_US:g} us"
            )
        if not 0 <= gain_db <= GAIN_MAX_DB:
            raise CameraError(
                f"camera {self.info.serial}, Gain: {gain_db:g} dB is outside its range of 0 to "
                f"{GAIN_MAX_DB:g} dB"
            )
        self._exposure_us = float(round(exposure_us))
        self._gain_db = gain_db
        return self._exposure_us

    def arm(self, trigger: Trigger = "software", frames: int = 1) -> None:
        """Get ready for triggers and discard frames in progress; all ``frames`` have a buffer."""
        self._check()
        self._armed = trigger
        self._stale = False
        self._started.clear()
        self._pulses_ns = clock.monotonic_ns()
        self._pulse_id = self._next_id

    def trigger(self) -> int:
        """Start one exposure and return the id of its frame."""
        frame_id = self._announce("software")
        self._expose(frame_id, clock.monotonic_ns(), lasting=self._realtime)
        return frame_id

    def expect(self) -> int:
        """Announce one trigger pulse of the bench state and return the id of its frame."""
        return self._announce("line")

    def fetch(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None = None
    ) -> CameraFrame:
        """Wait until the exposure has ended and return its frame; older frames are dropped."""
        self._check()
        on_line = self._armed == "line" and self._pulse_id <= frame_id < self._next_id
        if frame_id not in self._started and not on_line:
            raise CameraError(f"camera {self.info.serial}: no frame {frame_id} is under way")
        for older in [i for i in self._started if i < frame_id]:
            del self._started[older]
        self._stale = True
        exposure, end_ns = self._wait(frame_id, timeout_s, waiting)
        self._stale = False
        del self._started[frame_id]
        pixels = self._sensor.pixels(exposure, end_ns, waiting)
        led = self._bench.led(exposure.start_ns)
        if exposure.end_ns is None and self._bench.led(clock.monotonic_ns()) != led:
            # The board's watchdog cut the light off: the rig discards the frame, and shoots again.
            self._sensor.forget(led, exposure)
            self._lamps_ns = exposure.lamps_ns
        return CameraFrame(
            pixels=pixels,
            frame_id=frame_id,
            timestamp_ns=exposure.start_ns,
            exposure_us=exposure.exposure_us,
            gain_db=exposure.gain_db,
            temperature_c=None,
        )

    def disarm(self) -> None:
        """Stop responding to triggers."""
        self._check()
        self._armed = None

    def unplug(self) -> None:
        """Unplug the camera: it only closes from now on."""
        self._unplugged = True

    def close(self) -> None:
        """Close camera and bench state; closing twice does nothing."""
        self._bench.close()
        self._closed = True

    def _check(self) -> None:
        if self._unplugged:
            raise CameraGoneError(f"camera {self.info.serial} no longer answers: was it unplugged?")
        if self._closed:
            raise CameraError(f"camera {self.info.serial} is closed")

    def _announce(self, trigger: Trigger) -> int:
        self._check()
        if self._armed is None:
            raise CameraError(f"camera {self.info.serial} was triggered before it was armed")
        if self._armed != trigger:
            raise CameraError(
                f"camera {self.info.serial} is armed for triggers by {self._armed}, not {trigger}"
            )
        if self._stale:
            self.arm(trigger)
        self._next_id += 1
        return self._next_id - 1

    def _expose(self, frame_id: int, start_ns: int, *, lasting: bool) -> None:
        if self.faults.get(frame_id) == "unplug":
            self.unplug()
            self._check()
        end_ns = start_ns + round(self._exposure_us * 1000) if lasting else None
        if end_ns is not None:
            self._bench.expose(start_ns, end_ns)
        self._started[frame_id] = Exposure(
            start_ns, end_ns, self._exposure_us, self._gain_db, self._lamps_ns
        )
        self._lamps_ns += round(self._exposure_us * 1000)

    def _read_line(self, frame_id: int) -> None:
        """Start an exposure at each new trigger pulse up to the one of this frame.

        A fault at a later pulse, for example an unplugged camera, must not lose earlier frames.
        """
        now_ns = clock.monotonic_ns()
        for pulse in self._bench.triggers():
            if self._pulse_id > frame_id:
                return
            if self._pulses_ns < pulse.time_ns <= now_ns:
                self._expose(self._pulse_id, pulse.time_ns, lasting=True)
                # Pulses that follow this one too soon are missed.
                busy_us = max(self._exposure_us, FRAME_PERIOD_US)
                self._pulses_ns = pulse.time_ns + round(busy_us * 1000) - 1
                self._pulse_id += 1

    def _wait(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None
    ) -> tuple[Exposure, int]:
        """Wait for the end of a frame's exposure; return the exposure and its end in ns."""
        fault = self.faults.get(frame_id)
        if fault == "late":
            del self.faults[frame_id]
        began_s = called_s = clock.monotonic()
        while True:
            self._check()
            if self._armed == "line":
                self._read_line(frame_id)
            exposure = self._started.get(frame_id)
            now_s = clock.monotonic()
            left_s = began_s + timeout_s - now_s
            if exposure is not None and fault is None:
                now_ns = clock.monotonic_ns()
                if exposure.end_ns is None:
                    return exposure, max(now_ns, exposure.start_ns + 1)
                if now_ns >= exposure.end_ns:
                    return exposure, exposure.end_ns
                pause_s = (exposure.end_ns - now_ns) / 1e9
            else:
                pause_s = _POLL_S if self._armed == "line" else left_s
            if left_s <= 0:
                line = f", armed on {LINE}," if self._armed == "line" else ":"
                raise FrameTimeoutError(
                    f"camera {self.info.serial}{line} frame {frame_id} did not come within "
                    f"{timeout_s:g} s of waiting; check trigger and cable"
                )
            clock.sleep(max(0.0, min(pause_s, left_s, _WAITING_EVERY_S)))
            if waiting is not None and clock.monotonic() - called_s >= _WAITING_EVERY_S:
                waiting()
                called_s = clock.monotonic()
