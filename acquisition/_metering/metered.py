"""What metering found."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from acquisition._metering.light_level import MeteringGoal
from acquisition._plan.plan import CapturePlan


@dataclass(frozen=True)
class MeteredLight:
    """What was found for one LED.

    Parameters
    ----------
    led
        The LED.
    exposure_us
        The exposure that suits it, as it is asked of the camera.
    level
        The percentile reached at it, as a fraction of the range from black to white.
    clipped_fraction
        Share of saturated samples at it.
    shots
        How many frames it took.
    state
        ``ok``, ``too dark`` at the longest exposure, ``too bright`` at the shortest, ``coarse``
        where the camera's steps leave none that fits, or ``dead``: no light of its own.
    """

    led: int
    exposure_us: float
    level: float
    clipped_fraction: float
    shots: int
    state: str


@dataclass(frozen=True)
class Metered:
    """What metering led to.

    Parameters
    ----------
    plan
        The plan with the exposures found and without dead LEDs.
    lights
        What was measured, in the order of the plan it began with.
    goal
        What was wanted.
    black_dn, white_dn
        The range of grey values that fractions are of.
    """

    plan: CapturePlan
    lights: tuple[MeteredLight, ...]
    goal: MeteringGoal
    black_dn: float
    white_dn: float

    @property
    def dead_leds(self) -> tuple[int, ...]:
        """LEDs that give no light."""
        return tuple(light.led for light in self.lights if light.state == "dead")

    @property
    def warnings(self) -> tuple[str, ...]:
        """What an operator should know, one line each."""
        lines = {
            "dead": "gives no light up to {0:g} ms: left out; check its wire, then dead_leds",
            "too dark": "reaches {1:.0%} of full scale at the longest exposure of {0:g} ms: raise "
            "the gain or the longest exposure, or open the lens",
            "too bright": "is saturated at the shortest exposure of {0:g} ms: close the lens",
            "coarse": "is at {1:.0%} of full scale at {0:g} ms: no exposure tried came nearer",
        }
        return tuple(
            f"LED {light.led} {lines[light.state].format(light.exposure_us / 1000, light.level)}"
            for light in self.lights
            if light.state != "ok"
        )

    def details(self) -> dict[str, Any]:
        """Return what the event ``metered`` of a session says."""
        return {
            **asdict(self.goal),
            "black_dn": self.black_dn,
            "white_dn": self.white_dn,
            "lights": [asdict(light) for light in self.lights],
            "dead_leds": list(self.dead_leds),
        }
