"""A camera that sees what the virtual board lights.

It lives in the host's own process and stands behind `rig.Camera`; it is not a GenICam device.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition import NoiseModel
from rig import CameraError, CameraFrame, CameraInfo
from simulator._bench_state import BenchState
from simulator._lamps import Lamps
from simulator._sensor import fixed_pattern, sensor_image
from simulator._shake import shifted

Planes = Callable[[int | None], npt.NDArray[np.float32]]
CameraFault = Literal["lost", "late", "unplug"]

EXPOSURE_MIN_US = 10.0
EXPOSURE_MAX_US = 10_000_000.0
GAIN_MAX_DB = 24.0

_BAYER = {"RGGB": "RG", "GRBG": "GR", "GBRG": "GB", "BGGR": "BG"}
_STEADY = Lamps()
_SHAKE_TAG = 0x5AFE  # keeps the shake's random numbers apart from others of the shot


@dataclass(frozen=True)
class _Exposure:
    """One exposure under way; ``lamps_ns`` is its start on the lamps' clock."""

    start_ns: int
    exposure_us: float
    gain_db: float
    lamps_ns: int


class VirtualCamera:
    """A camera with a global shutter whose pixels collect the light of the bench state.

    A frame holds ``exposure * planes(None)`` plus ``planes(led)`` times the time that this LED
    burned during the exposure, for every LED that did, as the sensor renders it. So a frame taken
    under the wrong LED, or while the light went out, shows it.

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
        False does not wait for exposures to pass: the time between trigger and fetch stands for
        the exposure.
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
        if cfa is not None and cfa not in _BAYER:
            raise CameraError(f"camera {name}: cfa {cfa!r} is not one of {', '.join(_BAYER)}")
        if not 0 <= shake_px < math.inf:
            raise CameraError(f"camera {name}: a shake of {shake_px} px cannot be: 0 or more")
        self.info = CameraInfo(
            vendor="sgp",
            model="virtual camera",
            serial=name,
            width=size[1],
            height=size[0],
            pixel_format=("Mono" if cfa is None else f"Bayer{_BAYER[cfa]}") + f"{noise.bit_depth}",
            bit_depth=noise.bit_depth,
            cfa=cfa,
            exposure_min_us=EXPOSURE_MIN_US,
            exposure_max_us=EXPOSURE_MAX_US,
        )
        self.faults = dict(faults or {})
        self._planes = planes
        self._bench = bench
        self._noise = noise
        self._seed = seed
        self._noisy = noisy
        self._realtime = realtime
        self._lamps = lamps
        self._lamps_ns = 0
        self._shake_px = shake_px
        self._pattern = fixed_pattern(noise, size, seed=sensor_seed)
        self._exposure_us = 10_000.0
        self._gain_db = 0.0
        self._armed = False
        self._gone = ""
        self._next_id = 0
        # Every frame that is under way.
        self._started: dict[int, _Exposure] = {}
        self._taken: dict[tuple[int, ...], int] = {}
        # The first call compiles or loads the kernel: seconds that must not pass under a light.
        sensor_image(np.zeros((1, 1), np.float32), noise, key=(0,))

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

    def arm(self) -> None:
        """Make ready for triggers and forget frames that are under way."""
        self._check()
        self._started.clear()
        self._armed = True

    def trigger(self) -> int:
        """Start one exposure and return the id its frame will carry."""
        self._check()
        if not self._armed:
            raise CameraError(f"camera {self.info.serial} was triggered before it was armed")
        frame_id = self._next_id
        self._next_id += 1
        if self.faults.get(frame_id) == "unplug":
            self._gone = "does not answer any more: was it unplugged?"
            self._check()
        self._started[frame_id] = _Exposure(
            time.monotonic_ns(), self._exposure_us, self._gain_db, self._lamps_ns
        )
        self._lamps_ns += round(self._exposure_us * 1000)
        return frame_id

    def fetch(self, frame_id: int, timeout_s: float) -> CameraFrame:
        """Wait until the exposure has passed and return its frame; older ones are dropped."""
        self._check()
        if frame_id not in self._started:
            raise CameraError(f"camera {self.info.serial}: no frame {frame_id} is under way")
        for older in [i for i in self._started if i < frame_id]:
            del self._started[older]
        exposure = self._started[frame_id]
        start_ns, exposure_us = exposure.start_ns, exposure.exposure_us
        fault = self.faults.get(frame_id)
        if fault == "late":
            del self.faults[frame_id]
        passes_s = exposure_us / 1e6 - (time.monotonic_ns() - start_ns) / 1e9
        if fault is not None or (self._realtime and passes_s > timeout_s):
            time.sleep(timeout_s)
            raise CameraError(
                f"camera {self.info.serial}: frame {frame_id} did not come within {timeout_s:g} s "
                "of waiting; check trigger and cable"
            )
        if self._realtime:
            time.sleep(max(0.0, passes_s))
            end_ns = start_ns + round(exposure_us * 1000)
        else:
            end_ns = max(time.monotonic_ns(), start_ns + 1)
        del self._started[frame_id]
        key = self._key(self._bench.led(start_ns), exposure_us, exposure.gain_db)
        return CameraFrame(
            pixels=sensor_image(
                self._photons(exposure, end_ns, key),
                self._noise,
                exposure_us=exposure_us,
                gain_db=exposure.gain_db,
                key=key if self._noisy else None,
                pattern=self._pattern,
            ),
            frame_id=frame_id,
            timestamp_ns=start_ns,
            exposure_us=exposure_us,
            gain_db=exposure.gain_db,
            temperature_c=None,
        )

    def disarm(self) -> None:
        """Stop taking triggers."""
        self._check()
        self._armed = False

    def close(self) -> None:
        """Give camera and bench state back; closing twice does nothing."""
        self._bench.close()
        self._gone = self._gone or "is closed"

    def _check(self) -> None:
        if self._gone:
            raise CameraError(f"camera {self.info.serial} {self._gone}")

    def _photons(
        self, exposure: _Exposure, end_ns: int, key: tuple[int, ...]
    ) -> npt.NDArray[np.float32]:
        photons = self._plane(None) * np.float32(exposure.exposure_us)
        for led, lit_ns in self._bench.lit_ns(exposure.start_ns, end_ns).items():
            lit_us = exposure.exposure_us * lit_ns / (end_ns - exposure.start_ns)
            lit_us *= self._lamps.factor(led, exposure.lamps_ns, lit_us, key)
            photons += self._plane(led) * np.float32(lit_us)
        if self._shake_px:
            right, down = np.random.default_rng((*key, _SHAKE_TAG)).normal(0, self._shake_px, 2)
            photons = shifted(photons, (right, down), mosaic=self.info.cfa is not None)
        return photons

    def _plane(self, led: int | None) -> npt.NDArray[np.float32]:
        plane = self._planes(led)
        if plane.shape != (self.info.height, self.info.width) or plane.dtype != np.float32:
            raise CameraError(
                f"camera {self.info.serial}: the plane of LED {led} is {plane.dtype} of shape "
                f"{plane.shape}, wanted float32 of {(self.info.height, self.info.width)}"
            )
        return plane

    def _key(self, led: int | None, exposure_us: float, gain_db: float) -> tuple[int, ...]:
        shot = (
            self._seed,
            0 if led is None else led + 1,
            round(exposure_us * 1000),
            round(gain_db * 1000),
        )
        repeat = self._taken.get(shot, 0)
        self._taken[shot] = repeat + 1
        return (*shot, repeat)
