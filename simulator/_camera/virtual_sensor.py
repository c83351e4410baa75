"""The virtual camera's sensor: grey values from the light during an exposure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rig import CameraError, CameraInfo
from simulator._bench_state import BenchState
from simulator._camera.image_formation import ImageFormation
from simulator._camera.sensor import fixed_pattern, sensor_image
from simulator._camera.shake import shake_of, shifted

Planes = Callable[[int | None], npt.NDArray[np.float32]]


@dataclass(frozen=True)
class Exposure:
    """One exposure; ``lamps_ns`` is its start on the clock of `Lamps`.

    ``end_ns``: None if the exposure lasts until its frame is fetched.
    """

    start_ns: int
    end_ns: int | None
    exposure_us: float
    gain_db: float
    lamps_ns: int


class VirtualSensor:
    """Sensor of a `VirtualCamera`; see there for the parameters."""

    def __init__(
        self,
        planes: Planes,
        info: CameraInfo,
        bench: BenchState,
        formation: ImageFormation,
    ) -> None:
        self._planes = planes
        self._info = info
        self._bench = bench
        self._formation = formation
        self._pattern = fixed_pattern(
            formation.noise, (info.height, info.width), seed=formation.sensor_seed
        )
        self._taken: dict[tuple[int, ...], int] = {}
        # The first call compiles or loads the kernel, which must not take seconds while an LED
        # is on.
        sensor_image(np.zeros((1, 1), np.float32), formation.noise, key=(0,))

    def pixels(self, exposure: Exposure, end_ns: int) -> npt.NDArray[np.uint16]:
        """Return the grey values of an exposure that ended at ``end_ns``.

        Raises
        ------
        CameraError
            If a plane has the wrong size or type.
        """
        key = self._key(self._bench.led(exposure.start_ns), exposure)
        return sensor_image(
            self._photons(exposure, end_ns, key),
            self._formation.noise,
            exposure_us=exposure.exposure_us,
            gain_db=exposure.gain_db,
            key=key if self._formation.noisy else None,
            pattern=self._pattern,
        )

    def _photons(
        self, exposure: Exposure, end_ns: int, key: tuple[int, ...]
    ) -> npt.NDArray[np.float32]:
        photons = self._plane(None) * np.float32(exposure.exposure_us)
        for led, lit_ns in self._bench.lit_ns(exposure.start_ns, end_ns).items():
            lit_us = exposure.exposure_us * lit_ns / (end_ns - exposure.start_ns)
            lit_us *= self._formation.lamps.factor(led, exposure.lamps_ns, lit_us, key)
            photons += self._plane(led) * np.float32(lit_us)
        if self._formation.shake_px:
            shift_px = shake_of(key, self._formation.shake_px)
            photons = shifted(photons, shift_px, mosaic=self._info.cfa is not None)
        return photons

    def _plane(self, led: int | None) -> npt.NDArray[np.float32]:
        plane = self._planes(led)
        if plane.shape != (self._info.height, self._info.width) or plane.dtype != np.float32:
            raise CameraError(
                f"camera {self._info.serial}: the plane of LED {led} is {plane.dtype} of shape "
                f"{plane.shape}, expected float32 of shape {(self._info.height, self._info.width)}"
            )
        return plane

    def _key(self, led: int | None, exposure: Exposure) -> tuple[int, ...]:
        shot = (
            self._formation.seed,
            0 if led is None else led + 1,
            round(exposure.exposure_us * 1000),
            round(exposure.gain_db * 1000),
        )
        repeat = self._taken.get(shot, 0)
        self._taken[shot] = repeat + 1
        return (*shot, repeat)
