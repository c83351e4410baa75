"""Light over time: the light of an LED during one exposure, relative to its nominal intensity."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from acquisition import DataError
from rig import short_repr
from simulator.noise.dice import normal_pair, stream, uniform

_TAG = 0x1A3B  # keeps the lamps' random numbers apart from the sensor's


@dataclass(frozen=True)
class Lamps:
    """Faults of LEDs and of their drivers; the default has none.

    The intensity in a scene is the mean over a PWM cycle of a warm LED.

    Parameters
    ----------
    warm_up
        Relative excess of light of cold LEDs over warm LEDs, greater than -1. LEDs lose light as
        they warm up, so it is usually positive.
    warm_up_s
        Time in which the excess falls to 1/e, seconds.
    flicker
        Relative standard deviation of the light from shot to shot, less than 0.3.
    pwm_hz
        Frequency of a driver that dims by pulses; None for a constant current. Exposures begin at
        any phase, so a short one receives more or less light than its share. All pixels are
        exposed at once, so the brightness varies between frames and not within a frame.
    pwm_duty
        Share of a cycle in which the LED is on, above 0 and at most 1.
    dead
        LEDs that give no light.

    Raises
    ------
    DataError
        If a value is outside its range.
    """

    warm_up: float = 0.0
    warm_up_s: float = 60.0
    flicker: float = 0.0
    pwm_hz: float | None = None
    pwm_duty: float = 1.0
    dead: tuple[int, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise DataError(f"lamps: {item.name} is {value}, not a number")
        if not self.warm_up > -1 or not self.warm_up_s > 0:
            raise DataError(
                f"lamps: warm_up {self.warm_up:g}, warm_up_s {self.warm_up_s:g} s are out of "
                "range: warm_up > -1, warm_up_s > 0"
            )
        if not 0 <= self.flicker < 0.3:
            raise DataError(f"lamps: flicker is {self.flicker:g}, it must be within 0..0.3")
        if (self.pwm_hz is not None and not self.pwm_hz > 0) or not 0 < self.pwm_duty <= 1:
            raise DataError(
                f"lamps: pwm_hz {self.pwm_hz}, pwm_duty {self.pwm_duty:g} are out of range: "
                "pwm_hz > 0, pwm_duty above 0 and at most 1"
            )
        if any(led < 0 for led in self.dead):
            raise DataError(f"lamps: dead LEDs {list(self.dead)} must not be negative")

    def factor(
        self, led: int, start_ns: int, exposure_us: float, shot_key: tuple[int, ...]
    ) -> float:
        """Return the mean light of an LED during an exposure, relative to its intensity.

        Parameters
        ----------
        led
            Number of the LED.
        start_ns
            Start of the exposure, counted from when the cold lamps were switched on.
        exposure_us
            Exposure time, greater than 0.
        shot_key
            Non-negative integers that identify the shot. Flicker and the phase of the PWM depend
            only on them and the LED, not on the order of shots.

        Returns
        -------
        float
            Factor, not negative; 1 without faults.
        """
        if led in self.dead:
            return 0.0
        value = 1.0 + self.warm_up * self._cold_share(start_ns / 1e9, exposure_us / 1e6)
        if self.flicker == 0 and self.pwm_hz is None:
            return value
        state = stream(*shot_key, led, _TAG)
        value *= max(0.0, 1.0 + self.flicker * normal_pair(state, 0)[0])
        if self.pwm_hz is not None:
            cycles = exposure_us / 1e6 * self.pwm_hz
            value *= gate_share(uniform(state, 2), cycles, self.pwm_duty) / self.pwm_duty
        return float(value)

    def _cold_share(self, start_s: float, exposure_s: float) -> float:
        """Return the mean of exp(-t / warm_up_s) over the exposure."""
        length = exposure_s / self.warm_up_s
        return math.exp(-start_s / self.warm_up_s) * -math.expm1(-length) / length


def gate_share(phase: float, cycles: float, duty: float) -> float:
    """Return the exact share of a window in which a periodic gate is open.

    Parameters
    ----------
    phase
        Phase of the gate when the window begins, in cycles; the gate opens at 0.
    cycles
        Length of the window in cycles, greater than 0.
    duty
        Share of each cycle in which the gate is open, 0 to 1.
    """
    return (_open_until(phase + cycles, duty) - _open_until(phase, duty)) / cycles


def _open_until(cycles: float, duty: float) -> float:
    """Return the time, in cycles, that the gate was open since it first opened."""
    whole = math.floor(cycles)
    return whole * duty + min(cycles - whole, duty)
