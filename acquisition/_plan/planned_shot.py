"""One planned frame: its identity and its file name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from acquisition._errors import DataError
from acquisition._values.lights import led_id

Role = Literal["light", "dark", "ambient", "flat"]
ShotKey = tuple[Role, int | None, int, int]


@dataclass(frozen=True)
class PlannedShot:
    """One planned frame.

    Parameters
    ----------
    role
        ``light`` (one LED is on), ``dark``, ``ambient`` (both with all LEDs off) or ``flat`` (a
        white card).
    led
        LED number from 0 for a light, None otherwise.
    bracket
        Index of the bracket from 0; for dark and ambient frames the index of their exposure time
        in `CapturePlan.distinct_exposures_us`.
    repeat
        0 for the first shot of this LED and bracket, then 1, 2 ...
    exposure_us
        Requested exposure time, microseconds; None if it is unknown (imported images).
    flat_led
        LED that lights a flat; not part of its identity. None for other roles.
    """

    role: Role
    led: int | None
    bracket: int
    repeat: int
    exposure_us: float | None
    flat_led: int | None = None

    @property
    def lit_led(self) -> int | None:
        """The LED that is on during the shot, None if all LEDs are off."""
        return self.flat_led if self.led is None else self.led

    @property
    def key(self) -> ShotKey:
        """Identity of the shot; a retake has the key of the shot that it replaces."""
        return self.role, self.led, self.bracket, self.repeat

    @property
    def file(self) -> str:
        """File name of the first take inside ``frames/``."""
        return self.take_file(self.repeat)

    def take_file(self, number: int) -> str:
        """Return the file name with the number of a repeat or retake (0: no number)."""
        return f"{self._stem()}{f'_R{number}' if number else ''}.tif"

    def _stem(self) -> str:
        if self.led is not None:
            return f"{led_id(self.led)}_E{self.bracket}"
        if self.role == "flat":
            return f"F_E{self.bracket}"
        if self.exposure_us is None:
            raise DataError(f"a {self.role} frame needs an exposure time: its file is named by it")
        exposure = float(self.exposure_us)
        text = str(int(exposure)) if exposure.is_integer() else repr(exposure)
        return f"{'D' if self.role == 'dark' else 'A'}_{text}us"
