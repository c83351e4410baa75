"""A camera that sees what the virtual board lights.

It lives in the host's own process and stands behind `rig.Camera`; it is not a GenICam device.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Literal

from acquisition import NoiseModel
from rig import CameraError, CameraFrame, CameraInfo, FrameTimeoutError, Trigger
from simulator._bench_state import BenchState
from simulator._camera.sensor import pixel_format
from simulator._camera.virtual_sensor import Exposure, Planes, VirtualSensor
from simulator._scene.lamps import Lamps
from simulator._scene.lens import CFAS

__all__ = ["CameraFault", "Planes", "VirtualCamera"]

CameraFault = Literal["lost", "late", "unplug"]

EXPOSURE_MIN_US = 10.0
EXPOSURE_MAX_US = 10_000_000.0
GAIN_MAX_DB = 24.0
FRAME_PERIOD_US = 1000.0
LINE = "Line0"

_STEADY = Lamps()
_POLL_S = 0.001
_WAITING_EVERY_S = 0.1


class VirtualCamera:
    """A camera with a global shutter whose pixels collect the light of the bench state.

    A frame holds ``exposure * planes(None)`` plus ``planes(led)`` times the time that this LED
    burned during the exposure, for every LED that did, as the sensor renders it. So a frame taken
    under the wrong LED, or while the light went out, shows it. Armed on the line, it exposes at the
    trigger pulses of the bench state, and misses a pulse that comes while it exposes.

    All that is random about a frame depends on the seed, the LED, exposure, gain, and how many
    equal shots came before; not on the order of the others.

    Parameters
    ----------
    planes
        For an LED, ``(H, W)`` float32 photons per microsecond that its light alone yields (equal
        to electrons where the quantum efficiency is 1); for None, those of the ambient light,
        which is always there. Called while the light burns, so it must answer at once: render
        before.
    size
        (H, W) of the planes.
    bench
        What burns; closed with the camera.
    noise
        The sensor.
    seed
        Of noise, flicker, PWM phase and shake.
    noisy
        False leaves shot and read noise out.
    realtime
        False does not wait for exposures to pass: the time between software trigger and fetch
        stands for the exposure.
    name
        Stated as serial number.
    cfa
        Colours of the mosaic that the planes are, of its first 2 x 2 pixels row by row ("RGGB");
        None for monochrome.
    lamps
        The light over time. Its clock is the sum of all exposures triggered so far, so that the
        same shots give the same frames however fast the host is.
    shake_px
        Standard deviation, along each axis, of where the image lies in a frame.
    sensor_seed
        Of the fixed pattern of the sensor, where ``noise`` has one.
    faults
        By frame id: the frame is lost, comes late (after its fetch has given up), or the camera is
        unplugged instead of exposing.

    Raises
    ------
    CameraError
        If ``cfa`` or ``shake_px`` cannot be; by any method once the camera is closed or unplugged.
    """

    def __init__(
        self,
        planes: Planes,
        *,
        size: tuple[int, int],
        bench: BenchState,
        noise: NoiseModel,
        seed: int = 0,
        noisy: bool = True,
        realtime: bool = True,
        name: str = "virtual-camera",
        cfa: str | None = None,
        lamps: Lamps = _STEADY,
        shake_px: float = 0.0,
        sensor_seed: int = 0,
        faults: Mapping[int, CameraFault] | None = None,
    ) -> None:
        if cfa is not None and cfa not in CFAS:
            raise CameraError(f"camera {name}: cfa {cfa!r} is not one of {', '.join(CFAS)}")
        if not 0 <= shake_px < math.inf:
            raise CameraError(f"camera {name}: a shake of {shake_px} px cannot be: 0 or more")
        self.info = CameraInfo(
            vendor="sgp",
            model="virtual camera",
            serial=name,
            width=size[1],
            height=size[0],
            pixel_format=pixel_format(cfa, noise.bit_depth),
            bit_depth=noise.bit_depth,
            cfa=cfa,
            exposure_min_us=EXPOSURE_MIN_US,
            exposure_max_us=EXPOSURE_MAX_US,
            frame_period_us=FRAME_PERIOD_US,
        )
        self.faults = dict(faults or {})
        self._bench = bench
        self._sensor = VirtualSensor(
            planes,
            self.info,
            bench=bench,
            noise=noise,
            seed=seed,
            noisy=noisy,
            lamps=lamps,
            shake_px=shake_px,
            sensor_seed=sensor_seed,
        )
        self._realtime = realtime
        self._lamps_ns = 0
        self._exposure_us = 10_000.0
        self._gain_db = 0.0
        self._armed: Trigger | None = None
        self._gone = ""
        self._next_id = 0
        # The last fetch failed: what is under way is forgotten before the next trigger.
        self._stale = False
        # The line has been read up to this time; the next pulse's frame carries this id.
        self._pulses_ns = 0
        self._pulse_id = 0
        # Every frame that is under way.
        self._started: dict[int, Exposure] = {}

    def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> float:
        """Set exposure (in steps of 1 us) and gain for the triggers to come."""
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
        """Make ready for triggers and forget frames that are under way; there is room for all."""
        self._check()
        self._armed = trigger
        self._stale = False
        self._started.clear()
        self._pulses_ns = time.monotonic_ns()
        self._pulse_id = self._next_id

    def trigger(self) -> int:
        """Start one exposure and return the id its frame will carry."""
        frame_id = self._announce("software")
        self._expose(frame_id, time.monotonic_ns(), lasting=self._realtime)
        return frame_id

    def expect(self) -> int:
        """Announce one trigger pulse of the bench state and return the id of its frame."""
        return self._announce("line")

    def fetch(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None = None
    ) -> CameraFrame:
        """Wait until the exposure has passed and return its frame; older ones are dropped."""
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
        return CameraFrame(
            pixels=self._sensor.pixels(exposure, end_ns),
            frame_id=frame_id,
            timestamp_ns=exposure.start_ns,
            exposure_us=exposure.exposure_us,
            gain_db=exposure.gain_db,
            temperature_c=None,
        )

    def disarm(self) -> None:
        """Stop taking triggers."""
        self._check()
        self._armed = None

    def close(self) -> None:
        """Give camera and bench state back; closing twice does nothing."""
        self._bench.close()
        self._gone = self._gone or "is closed"

    def _check(self) -> None:
        if self._gone:
            raise CameraError(f"camera {self.info.serial} {self._gone}")

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
            self._gone = "does not answer any more: was it unplugged?"
            self._check()
        end_ns = start_ns + round(self._exposure_us * 1000) if lasting else None
        if end_ns is not None:
            self._bench.expose(start_ns, end_ns)
        self._started[frame_id] = Exposure(
            start_ns, end_ns, self._exposure_us, self._gain_db, self._lamps_ns
        )
        self._lamps_ns += round(self._exposure_us * 1000)

    def _read_line(self, frame_id: int) -> None:
        """Start an exposure at each trigger pulse since the line was read last, up to this frame's.

        What happens at later pulses, such as an unplugging, must not cost frames before them.
        """
        now_ns = time.monotonic_ns()
        for pulse in self._bench.triggers():
            if self._pulse_id > frame_id:
                return
            if self._pulses_ns < pulse.time_ns <= now_ns:
                self._expose(self._pulse_id, pulse.time_ns, lasting=True)
                # A pulse that comes too soon after this one is missed.
                busy_us = max(self._exposure_us, FRAME_PERIOD_US)
                self._pulses_ns = pulse.time_ns + round(busy_us * 1000) - 1
                self._pulse_id += 1

    def _wait(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None
    ) -> tuple[Exposure, int]:
        """Return the exposure of a frame, and its end in ns, when it has passed."""
        fault = self.faults.get(frame_id)
        if fault == "late":
            del self.faults[frame_id]
        began_s = told_s = time.monotonic()
        while True:
            if self._armed == "line":
                self._read_line(frame_id)
            exposure = self._started.get(frame_id)
            now_s = time.monotonic()
            left_s = began_s + timeout_s - now_s
            if exposure is not None and fault is None:
                now_ns = time.monotonic_ns()
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
            time.sleep(max(0.0, min(pause_s, left_s, _WAITING_EVERY_S)))
            if waiting is not None and time.monotonic() - told_s >= _WAITING_EVERY_S:
                waiting()
                told_s = time.monotonic()
