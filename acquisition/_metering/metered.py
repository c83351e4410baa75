"""Results of metering."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

from acquisition._metering.light_level import MeteringGoal
from acquisition._plan.plan import CapturePlan
from rig import Notice, short_repr

_CODES: Final = {
    "dead": "led-dead",
    "too dark": "metering-too-dark",
    "too bright": "metering-too-bright",
    "coarse": "metering-coarse",
}


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
