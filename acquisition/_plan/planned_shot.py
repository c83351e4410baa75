"""One frame of a plan: which it is, and the file it goes to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from acquisition._errors import DataError
from acquisition._values.lights import led_id

Role = Literal["light", "dark", "ambient", "flat"]
ShotKey = tuple[Role, int | None, int, int]


@dataclass(frozen=True)
class PlannedShot:
    """One frame to take.

    Parameters
    ----------
    role
        ``light`` (one LED burns), ``dark``, ``ambient`` (both with all LEDs off) or ``flat`` (a
        white card).
    led
        LED number from 0 for a light, None otherwise.
    bracket
        Index of the exposure from 0; for dark and ambient frames the place of their exposure
        among all that the plan has.
    repeat
        0 for the first shot of this LED and bracket, then 1, 2 ...
    exposure_us
        Exposure time asked for, microseconds; None where it is not known (imported images).
    flat_led
        The LED that lights a flat, which does not identify it; None otherwise.
    """

    role: Role
    led: int | None
    bracket: int
    repeat: int
    exposure_us: float | None
    flat_led: int | None = None

    @property
    def lit_led(self) -> int | None:
        """The LED that burns during the shot, None where all are dark."""
        return self.flat_led if self.led is None else self.led

    @property
    def key(self) -> ShotKey:
        """What identifies the shot: a retake has the key of the shot it replaces."""
        return self.role, self.led, self.bracket, self.repeat

    @property
    def file(self) -> str:
        """File name inside ``frames/`` of the first take."""
        return self.take_file(self.repeat)

    def take_file(self, number: int) -> str:
        """File name with the running number that tells repeats and retakes apart (0: none)."""
        return f"{self._stem()}{f'_R{number}' if number else ''}.tif"

    def _stem(self) -> str:
        if self.led is not None:
            return f"{led_id(self.led)}_E{self.bracket}"
        if self.role == "flat":
            return f"F_E{self.bracket}"
        if self.exposure_us is None:
            raise DataError(f"a {self.role} frame needs its exposure: it is filed by it")
        exposure = float(self.exposure_us)
        text = str(int(exposure)) if exposure.is_integer() else repr(exposure)
        return f"{'D' if self.role == 'dark' else 'A'}_{text}us"
