"""Metering: try exposures on a rig until every light reaches the target level."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from acquisition._errors import DataError
from acquisition.metering.light_level import (
    LightLevel,
    MeteringGoal,
    better_exposure_us,
    light_level,
    reached,
    stepped_us,
)
from acquisition.plan.plan import CapturePlan, PlanEstimate, frame_bytes
from rig import Notice, Progress, Rig, RigError, no_progress, short_repr

_CODES: Final = {
    "dead": "led-dead",
    "too dark": "metering-too-dark",
    "too bright": "metering-too-bright",
    "coarse": "metering-coarse",
}
# Trial shots of an LED.
MOST_TRIALS = 16
# An LED whose frame is above the unlit frame by less than this share and these grey values is dead:
# a flickering room light may cause the same difference.
_LEAST_SHARE = 0.02
_LEAST_DN = 1.0
# Share of the longest time for which the board keeps an LED on; settling and repeated commands
# need the rest.
_SHARE_OF_HOLD = 0.5


@dataclass(frozen=True)
class MeteredLight:
    """Result of metering one LED.

    Parameters
    ----------
    led
        The LED.
    exposure_us
        Chosen exposure as requested from the camera, microseconds.
    level
        Percentile reached at this exposure, as a fraction of the range from black to white.
    clipped_fraction
        Share of saturated samples at this exposure.
    shots
        Number of trial frames.
    state
        ``ok``, ``too dark`` at the longest exposure, ``too bright`` at the shortest, ``coarse`` if
        the camera's exposure steps are too large to reach the target, or ``dead`` without light.
    """

    led: int
    exposure_us: float
    level: float
    clipped_fraction: float
    shots: int
    state: str


@dataclass(frozen=True)
class Metered:
    """Result of metering a plan.

    Parameters
    ----------
    plan
        The plan with the metered exposures and without dead LEDs.
    lights
        Results of all LEDs, in the order of the original plan.
    goal
        Target of the metering.
    black_dn, white_dn
        Black and white level that fractions refer to.
    """

    plan: CapturePlan
    lights: tuple[MeteredLight, ...]
    goal: MeteringGoal
    black_dn: float
    white_dn: float

    __repr__ = short_repr

    @property
    def dead_leds(self) -> tuple[int, ...]:
        """LEDs that gave no light."""
        return tuple(light.led for light in self.lights if light.state == "dead")

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """Warnings for the operator."""
        lines = {
            "dead": "gives no light up to {0:g} ms: left out; check its wire, or list it in "
            "dead_leds",
            "too dark": "reaches {1:.0%} of full scale at the longest exposure of {0:g} ms: raise "
            "the gain or the longest exposure, or open the lens",
            "too bright": "is saturated at the shortest exposure of {0:g} ms: close the lens",
            "coarse": "is at {1:.0%} of full scale at {0:g} ms: no tested exposure is closer to "
            "the target",
        }
        return tuple(
            Notice(
                _CODES[light.state],
                f"LED {light.led} "
                + lines[light.state].format(light.exposure_us / 1000, light.level),
            )
            for light in self.lights
            if light.state != "ok"
        )

    def details(self) -> dict[str, Any]:
        """Return the details of the event ``metered`` of a session."""
        return {
            **asdict(self.goal),
            "black_dn": self.black_dn,
            "white_dn": self.white_dn,
            "lights": [asdict(light) for light in self.lights],
            "dead_leds": list(self.dead_leds),
        }


def meter(
    rig: Rig,
    plan: CapturePlan,
    goal: MeteringGoal | None = None,
    *,
    on_progress: Progress = no_progress,
) -> Metered:
    """Choose the exposures of a plan by trying them on the object under the camera.

    Parameters
    ----------
    rig
        Open rig. It stays open, with all LEDs off.
    plan
        Plan with the LEDs and the gain. Its first bracket is metered; the others keep their ratio
        to it. Its ``max_clipped_fraction`` applies if it is less than the goal's.
    goal
        Target; default the 99.5th percentile at 0.7 of full scale.
    on_progress
        Receives the stage ``metering``, one step per LED.

    Returns
    -------
    Metered
        The level of each LED is measured at the chosen exposure, not extrapolated.

    Raises
    ------
    DataError
        If two brackets of an LED would have the same exposure time.
    RigError
        If board or camera fail, or no LED gives any light.

    Examples
    --------
    >>> from acquisition import CapturePlan
    >>> from acquisition.metering import meter
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("coin", width=64, height=52, leds=4))
    >>> plan = CapturePlan(leds="0-3", exposures_us=(100.0,))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     metered = meter(rig, plan)
    >>> all(abs(light.level - 0.7) < 0.1 for light in metered.lights)
    True
    """
    goal = goal or MeteringGoal()
    if plan.max_clipped_fraction < goal.max_clipped_fraction:
        goal = MeteringGoal(**{**asdict(goal), "max_clipped_fraction": plan.max_clipped_fraction})
    trial = _Trial(rig, plan.gain_db, goal)
    lights = []
    for led in plan.leds:
        lights.append(trial.light(led))
        on_progress("metering", len(lights), len(plan.leds))
    alive = [light for light in lights if light.state != "dead"]
    if not alive:
        raise RigError(
            f"no LED of rig {rig.config.name} gives light that camera {rig.camera.info.serial} "
            f"sees within {trial.high_us / 1000:g} ms: check the LEDs' power supply, the lens cap "
            "and the aperture"
        )
    least_us = min(light.exposure_us for light in alive)
    range_us = rig.camera.info.exposure_min_us, rig.camera.info.exposure_max_us
    by_led = {
        one.led: _brackets(plan, one.led, one.exposure_us if goal.each else least_us, range_us)
        for one in alive
    }
    chosen = plan.without(led for led in plan.leds if led not in by_led)[0]
    common = Counter(by_led.values()).most_common(1)[0][0]
    others = {led: own for led, own in by_led.items() if own != common}
    return Metered(
        chosen.changed(exposures_us=common, exposures_by_led=others),
        tuple(lights),
        goal,
        trial.black_dn,
        trial.white_dn,
    )


class _Trial:
    """Takes trial shots and evaluates them."""

    def __init__(self, rig: Rig, gain_db: float, goal: MeteringGoal) -> None:
        info = rig.camera.info
        self._rig = rig
        self._gain_db = gain_db
        self._goal = goal
        self._low_us = info.exposure_min_us
        hold_us = _SHARE_OF_HOLD * rig.board.identity.max_hold_ms * 1000
        self.high_us = max(min(info.exposure_max_us, goal.longest_us, hold_us), self._low_us)
        self.white_dn = float(info.white_dn)
        # The shortest exposure collects hardly any room light or dark current: its level is black.
        unlit = rig.shoot(None, self._low_us, gain_db).frame
        self.black_dn = float(np.median(unlit.pixels))
        self._span_dn = self.white_dn - self.black_dn
        if self._span_dn <= 0:
            raise RigError(
                f"camera {info.serial} is saturated with all LEDs off at {self._low_us:g} us: "
                "darken the room, or lower its black level"
            )
        self._next_us = stepped_us(goal.start_us, self._low_us, self.high_us)
        self._unlit = {self._next_us: self._shoot(None, self._next_us)}

    def light(self, led: int) -> MeteredLight:
        """Find the exposure of one LED, starting from that of the previous LED."""
        goal, span_dn = self._goal, self._span_dn
        asked_us = self._next_us
        tried: dict[float, LightLevel] = {}
        while asked_us not in tried and len(tried) < MOST_TRIALS:
            level = tried[asked_us] = self._shoot(led, asked_us)
            if reached(level, goal, span_dn):
                break
            better_us = better_exposure_us(level, goal, span_dn)
            asked_us = stepped_us(better_us, self._low_us, self.high_us)
        asked_us = self._best(tried)
        level = tried[asked_us]
        state = self._state(asked_us, level)
        if not self._shines(asked_us, level):
            state = "dead"
        else:
            self._next_us = asked_us
        return MeteredLight(
            led,
            asked_us,
            round(level.level_dn / span_dn, 4),
            level.clipped_fraction,
            len(tried),
            state,
        )

    def _shoot(self, led: int | None, exposure_us: float) -> LightLevel:
        frame = self._rig.shoot(led, exposure_us, self._gain_db).frame
        return light_level(
            frame.pixels,
            frame.exposure_us,
            self._goal,
            black_dn=self.black_dn,
            white_dn=self.white_dn,
        )

    def _best(self, tried: dict[float, LightLevel]) -> float:
        """Return the unclipped exposure closest to the target; if all clip, the shortest."""
        target_dn = self._goal.fraction * self._span_dn
        unclipped = {
            us: abs(math.log(max(level.level_dn, 1e-9) / target_dn))
            for us, level in tried.items()
            if level.clipped_fraction <= self._goal.max_clipped_fraction
        }
        return min(unclipped, key=lambda us: unclipped[us]) if unclipped else min(tried)

    def _state(self, asked_us: float, level: LightLevel) -> str:
        goal = self._goal
        if reached(level, goal, self._span_dn):
            return "ok"
        if level.clipped_fraction > goal.max_clipped_fraction:
            return "too bright"
        if level.level_dn < goal.fraction * self._span_dn:
            if asked_us >= self.high_us:
                return "too dark"
            # The exposure is limited by saturation of a small part of the frame.
            if level.tail_dn > 0.9 * self._span_dn:
                return "ok"
        return "coarse"

    def _shines(self, asked_us: float, level: LightLevel) -> bool:
        """Return whether a frame has more light than one with all LEDs off."""
        start_us, start = next(iter(self._unlit.items()))
        expected_dn = start.level_dn * max(1.0, asked_us / start_us)
        if level.level_dn > 2 * expected_dn + 10 * _LEAST_DN:
            return True
        if asked_us not in self._unlit:
            self._unlit[asked_us] = self._shoot(None, asked_us)
        unlit = self._unlit[asked_us]
        return (
            level.level_dn - unlit.level_dn > _least_dn(unlit.level_dn)
            or level.mean_dn - unlit.mean_dn > _least_dn(unlit.mean_dn) / 2
        )


def _least_dn(unlit_dn: float) -> float:
    return max(_LEAST_DN, _LEAST_SHARE * unlit_dn)


def _brackets(
    plan: CapturePlan, led: int, first_us: float, range_us: tuple[float, float]
) -> tuple[float, ...]:
    """Return the exposures of all brackets of an LED, in the ratios of the plan."""
    planned, *others = plan.exposures_of(led)
    ratios = [us / planned for us in others]
    exposures = (first_us, *(stepped_us(first_us * ratio, *range_us) for ratio in ratios))
    for bracket, exposure_us in enumerate(exposures):
        if exposure_us in exposures[:bracket]:
            raise DataError(
                f"metering: bracket {bracket} of LED {led} would have the same exposure as another "
                f"bracket, {exposure_us:g} us: the camera exposes for {range_us[0]:g} to "
                f"{range_us[1]:g} us; change the ratios of exposures_us in the plan"
            )
    return exposures


def estimate_metered(
    plan: CapturePlan, *, each: bool, width: int, height: int, frame_s: float = 0.0
) -> tuple[PlanEstimate, int]:
    """Estimate the most that a plan costs if its exposures are metered.

    If each LED gets its own exposures, each needs its own dark and ambient frames; LEDs of nearly
    the same strength share them, so that fewer may be recorded. The exposure times are those of the
    plan, because metering has not been done.

    Parameters
    ----------
    plan
        The plan.
    each
        Whether each LED is metered, or one exposure is chosen for all.
    width, height
        Size of a frame of 16-bit samples, pixels.
    frame_s
        Overhead of a frame in addition to its exposure, seconds.

    Returns
    -------
    PlanEstimate, int
        Shots that are recorded, and the most trial shots, which are not; ``exposure_s`` and
        ``seconds`` include one trial shot of each LED, the least.

    Examples
    --------
    >>> from acquisition import CapturePlan
    >>> from acquisition.metering import estimate_metered
    >>> plan = CapturePlan(leds="0-35", exposures_us=(10_000.0,))
    >>> estimate_metered(plan, each=True, width=640, height=512)
    (PlanEstimate(shots=73, exposure_s=1.09, seconds=1.09, bytes=47841280), 576)
    """
    shots = plan.shots()
    exposures_us = [shot.exposure_us or 0.0 for shot in shots]
    unlit_us = [shot.exposure_us or 0.0 for shot in shots if shot.led is None]
    own_us = [us for led in plan.leds for us in plan.exposures_of(led)]
    if each:
        # As many unlit frames of each exposure time as the plan has, for those of all LEDs.
        roles = len(unlit_us) // len(plan.distinct_exposures_us)
        exposures_us = [
            *(shot.exposure_us or 0.0 for shot in shots if shot.led is not None),
            *own_us * roles,
        ]
    count = len(exposures_us)
    first_us = [plan.exposure_us(led, 0) for led in plan.leds]
    exposure_s = (sum(exposures_us) + sum(first_us)) / 1e6
    seconds = exposure_s + (count + len(first_us)) * frame_s
    size = count * frame_bytes(width, height)
    return PlanEstimate(count, exposure_s, seconds, size), MOST_TRIALS * len(plan.leds)
