"""One planned frame: its identity and its file name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from acquisition.values.lights import led_id

Role = Literal["light", "dark", "ambient", "flat", "repeat"]
ShotKey = tuple[Role, int | None, int, int]


@dataclass(frozen=True)
class PlannedShot:
    """One planned frame.

    Parameters
    ----------
    role
        ``light`` (one LED is on), ``dark``, ``ambient`` (both with all LEDs off), ``flat`` (a
        white card) or ``repeat`` (the first light again, after others).
    led
        Number from 0 of the LED that is on, None if all are off; None, too, for a flat under an
        unknown LED (a session without a plan).
    bracket
        Index of the bracket from 0; for dark and ambient frames the index of their exposure time
        in `CapturePlan.distinct_exposures_us`.
    repeat
        0 for the first shot of this LED and bracket, then 1, 2 ...
    exposure_us
        Requested exposure time, microseconds; None if it is unknown (imported images).
    """

    role: Role
    led: int | None
    bracket: int
    repeat: int
    exposure_us: float | None

    @property
    def key(self) -> ShotKey:
        """Identity of the shot; a retake has the key of the shot that it replaces.

        The LED of a light or repeat is part of it, the LED of a flat is not.
        """
        return self.role, None if self.role == "flat" else self.led, self.bracket, self.repeat

    @property
    def file(self) -> str:
        """File name of the first take inside ``frames/``."""
        return self.take_file(self.repeat)

    def take_file(self, number: int) -> str:
        """Return the file name with the number of a repeat or retake (0: no number)."""
        return f"{self._stem()}{f'_R{number}' if number else ''}.tif"

    def _stem(self) -> str:
        if self.role == "flat":
            return f"F_E{self.bracket}"
        if self.led is not None and self.role == "repeat":
            return f"R_{led_id(self.led)}_E{self.bracket}"
        if self.led is not None:
            return f"{led_id(self.led)}_E{self.bracket}"
        letter = "D" if self.role == "dark" else "A"
        if self.exposure_us is None:
            return f"{letter}_E{self.bracket}"
        exposure = float(self.exposure_us)
        text = str(int(exposure)) if exposure.is_integer() else repr(exposure)
        return f"{letter}_{text}us"
