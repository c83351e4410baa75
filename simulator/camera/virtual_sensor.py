"""The virtual camera's sensor: grey values from the light during an exposure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from acquisition import MapRows
from rig import CameraError, CameraInfo
from rig.arrays import Float32, UInt16
from simulator.bench.state import BenchState
from simulator.bench.wiring import Planes
from simulator.camera.sensor import FixedPattern, ImageFormation, fixed_pattern, sensor_image
from simulator.noise.dice import normal_pair, stream

# Pixels of a frame that are computed at once, and of a sensor whose pattern stays in memory.
_BAND, _KEPT = 2**22, 2**25
# Waves longer than 3 pixels keep amplitude and phase to 2e-4 under any shift.
_LOBES = 8  # lobes of the interpolation kernel on each side
_BETA = 7.0  # parameter of its Kaiser window
_TAG = 0x5AFE  # keeps the shake's random numbers apart from others of the shot


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
        self._pattern: FixedPattern | None = None
        if info.height * info.width <= _KEPT:
            self._pattern = self._drawn_pattern(slice(0, info.height))
        self._taken: dict[tuple[int, ...], int] = {}
        # The first call compiles or loads the kernel, which must not take seconds while an LED
        # is on.
        sensor_image(np.zeros((1, 1), np.float32), formation.noise, key=(0,))

    def pixels(
        self, exposure: Exposure, end_ns: int, waiting: Callable[[], None] | None = None
    ) -> UInt16:
        """Return the grey values of an exposure that ended at ``end_ns``.

        ``waiting`` is called after each of several bands.

        Raises
        ------
        CameraError
            If a plane has the wrong size or type.
        """
        key, height = self._key(self._bench.led(exposure.start_ns), exposure), self._info.height
        lit = self._lit(exposure, end_ns, key)
        # A shaken image needs its neighbours; all else is computed in bands, which may be on disk.
        step = height if self._formation.shake_px else max(1, _BAND // self._info.width)
        grey = np.zeros((height, self._info.width), np.uint16)
        for top in range(0, height, step):
            rows = slice(top, min(top + step, height))
            grey[rows] = sensor_image(
                self._photons(lit, key, rows),
                self._formation.noise,
                exposure_us=exposure.exposure_us,
                gain_db=exposure.gain_db,
                key=key if self._formation.noisy else None,
                pattern=self._pattern_of(rows),
                top=top,
            )
            if waiting is not None and rows.stop < height:
                waiting()
        return grey

    def _lit(
        self, exposure: Exposure, end_ns: int, key: tuple[int, ...]
    ) -> list[tuple[MapRows, np.float32]]:
        """Return the planes of the exposure, and for how many microseconds each was on."""
        lit = [(self._plane(None), np.float32(exposure.exposure_us))]
        for led, lit_ns in self._bench.lit_ns(exposure.start_ns, end_ns).items():
            lit_us = exposure.exposure_us * lit_ns / (end_ns - exposure.start_ns)
            lit_us *= self._formation.lamps.factor(led, exposure.lamps_ns, lit_us, key)
            lit.append((self._plane(led), np.float32(lit_us)))
        return lit

    def _photons(
        self,
        lit: list[tuple[MapRows, np.float32]],
        key: tuple[int, ...],
        rows: slice,
    ) -> Float32:
        (ambient, first_us), *others = lit
        photons = ambient[rows] * first_us
        for plane, lit_us in others:
            photons += plane[rows] * lit_us
        if self._formation.shake_px:
            shift_px = shake_of(key, self._formation.shake_px)
            photons = shifted(photons, shift_px, mosaic=self._info.cfa is not None)
        return photons

    def _pattern_of(self, rows: slice) -> FixedPattern | None:
        if self._info.height * self._info.width > _KEPT:
            return self._drawn_pattern(rows)
        return None if self._pattern is None else FixedPattern(self._pattern.maps[:, rows])

    def _drawn_pattern(self, rows: slice) -> FixedPattern | None:
        noise, seed = self._formation.noise, self._formation.sensor_seed
        size = rows.stop - rows.start, self._info.width
        return fixed_pattern(noise, size, seed=seed, top=rows.start)

    def _plane(self, led: int | None) -> MapRows:
        plane = self._planes(led)
        if plane.shape != (self._info.height, self._info.width) or plane.dtype != np.float32:
            raise CameraError(
                f"camera {self._info.serial}: the plane of LED {led} is {plane.dtype} of shape "
                f"{plane.shape}, expected float32 of shape {(self._info.height, self._info.width)}"
            )
        return plane

    def forget(self, led: int | None, exposure: Exposure) -> None:
        """Do not count the latest of equal shots, so that the next one gives the same frame."""
        self._taken[self._shot(led, exposure)] -= 1

    def _shot(self, led: int | None, exposure: Exposure) -> tuple[int, ...]:
        return (
            self._formation.seed,
            0 if led is None else led + 1,
            round(exposure.exposure_us * 1000),
            round(exposure.gain_db * 1000),
        )

    def _key(self, led: int | None, exposure: Exposure) -> tuple[int, ...]:
        shot = self._shot(led, exposure)
        repeat = self._taken.get(shot, 0)
        self._taken[shot] = repeat + 1
        return (*shot, repeat)


def shake_of(shot_key: tuple[int, ...], sigma_px: float) -> tuple[float, float]:
    """Return the shift of the image in a frame: right and down, pixels.

    Parameters
    ----------
    shot_key
        Non-negative integers that identify the shot.
    sigma_px
        Standard deviation along each axis.
    """
    right, down = normal_pair(stream(*shot_key, _TAG), 0)
    return sigma_px * right, sigma_px * down


def shifted(plane: Float32, shift_px: tuple[float, float], *, mosaic: bool) -> Float32:
    """Shift an image by band-limited interpolation (sinc under a Kaiser window).

    Parameters
    ----------
    plane
        ``(H, W)`` float32 image, not negative. It is continued beyond its edges by its mirror
        image.
    shift_px
        Shift of the image content to the right and down, pixels.
    mosaic
        True for a mosaic of 2 x 2 filters: each pixel is interpolated from pixels with the same
        filter.

    Returns
    -------
    Values
        ``(H, W)`` image, not negative. A shift of zero gives the same values.
    """
    step = 2 if mosaic else 1
    right, down = (_kernel(shift / step, step) for shift in shift_px)
    # Mirroring without repeating the edge pixel keeps the filters of a mosaic in phase.
    moved = cv2.sepFilter2D(plane, cv2.CV_32F, right, down, borderType=cv2.BORDER_REFLECT_101)
    return np.maximum(np.asarray(moved, np.float32), np.float32(0.0))


def _kernel(shift: float, step: int) -> Float32:
    """Return the taps that shift a row; they use every ``step``-th pixel and their sum is 1."""
    reach = _LOBES + math.ceil(abs(shift))
    # OpenCV correlates: tap k multiplies the sample k pixels to the right.
    offset = np.arange(-reach, reach + 1) + shift
    taps = np.sinc(offset) * np.i0(_BETA * np.sqrt(np.clip(1 - (offset / _LOBES) ** 2, 0.0, None)))
    taps[np.abs(offset) >= _LOBES] = 0.0
    kernel = np.zeros(2 * reach * step + 1, np.float32)
    kernel[::step] = taps / taps.sum()
    return kernel
