"""Reasons to reject a frame: too much of it is clipped, or its LED gave no light.

A short exposure may show no light although the LED was on. The light of the same LED at a longer
exposure then shows how much light can be expected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from acquisition._errors import DataError
from acquisition.pixels.frame_quality import FrameQuality
from acquisition.plan.planned_shot import PlannedShot, Role
from acquisition.session.journal import FrameLine
from acquisition.session.manifest import CameraRecord
from acquisition.session.session import Session
from rig import RigError

# Percentiles that rise if light falls on a large part of the frame, or on a thousandth of it.
_RISING: Final = ("50", "99", "99.9")
# Smallest rise that counts: this multiple of the dark frame's spread, and this many grey values.
_SPREADS: Final = 0.5
_LEAST_DN: Final = 1.0
# A smaller highlight must rise by this share of the sensor's range: single samples fluctuate less.
_HIGHLIGHT: Final = 0.05
# Light counts as missing if the expected rise is at least this multiple of the smallest rise.
_SURELY: Final = 3.0


@dataclass(frozen=True)
class SeenLight:
    """Rise of the percentiles of an LED's frame above those of the dark frame.

    Clipped samples make the rise smaller than that of the light.
    """

    exposure_us: float
    rise_dn: Mapping[str, int]

    @classmethod
    def of(
        cls,
        exposure_us: float,
        light_dn: Mapping[str, int],
        dark_dn: Mapping[str, int],
        range_dn: float,
    ) -> SeenLight | None:
        """Compute it from the percentiles of both frames; None if the frame shows no light."""
        if not is_lit(light_dn, dark_dn, range_dn):
            return None
        names = (*_RISING, "100")
        return cls(exposure_us, {name: light_dn[name] - dark_dn[name] for name in names})

    def must_show(self, exposure_us: float, dark_dn: Mapping[str, int], range_dn: float) -> bool:
        """Return whether the light of the same LED must be visible at another exposure."""
        share = exposure_us / self.exposure_us
        rise = {name: share * dn for name, dn in self.rise_dn.items()}
        margin_dn = _SURELY * _margin_dn(dark_dn)
        return (
            any(rise[name] > margin_dn for name in _RISING)
            or rise["100"] > _SURELY * _HIGHLIGHT * range_dn
        )


def rejection(
    shot: PlannedShot,
    quality: FrameQuality,
    *,
    dark: FrameQuality | None,
    seen: SeenLight | None = None,
    range_dn: float,
    max_clipped_fraction: float,
) -> RigError | DataError | None:
    """Judge a frame by its figures.

    Parameters
    ----------
    shot
        The planned shot.
    quality
        Figures of the frame.
    dark
        Figures of a frame of the same exposure with all LEDs off; if None, the light is not judged.
    seen
        Light of the LED at a longer exposure. A frame without light counts if the exposure is too
        short to show any.
    range_dn
        White level minus black level.
    max_clipped_fraction
        Largest allowed share of clipped samples.

    Returns
    -------
    RigError, DataError or None
        Error to raise if the shot cannot be taken again; None for a frame that counts.
    """
    exposure = "" if shot.exposure_us is None else f" at {shot.exposure_us:g} us"
    if quality.clipped_fraction > max_clipped_fraction:
        return DataError(
            f"{shot.file}: {quality.clipped_fraction:.3%} of the samples are clipped{exposure}, "
            f"the plan allows {max_clipped_fraction:.3%}; shorten the exposure, or raise "
            "max_clipped_fraction"
        )
    if shot.led is None or dark is None:
        return None
    if is_lit(quality.percentiles_dn, dark.percentiles_dn, range_dn):
        return None
    if (
        seen is not None
        and shot.exposure_us is not None
        and not seen.must_show(shot.exposure_us, dark.percentiles_dn, range_dn)
    ):
        return None
    if _is_darker(quality.percentiles_dn, dark.percentiles_dn):
        return RigError(
            f"{shot.file}: the frame of LED {shot.led} is darker{exposure} than the frame with "
            "all LEDs off: other light fell on that one; darken the room, then record into a new "
            "folder"
        )
    return RigError(
        f"{shot.file}: LED {shot.led} gave no light{exposure}: the frame is no brighter than "
        "the one with all LEDs off; check the LED and the lens, lengthen the exposure, or list the "
        "LED in dead_leds of the rig file"
    )


def is_lit(light_dn: Mapping[str, int], dark_dn: Mapping[str, int], range_dn: float) -> bool:
    """Return whether light fell on a frame, from its percentiles and those of a dark frame."""
    margin_dn = _margin_dn(dark_dn)
    if any(light_dn[name] >= dark_dn[name] + margin_dn for name in _RISING):
        return True
    return light_dn["100"] > dark_dn["100"] + _HIGHLIGHT * range_dn


def _is_darker(light_dn: Mapping[str, int], dark_dn: Mapping[str, int]) -> bool:
    """Return whether a frame is darker than the dark frame."""
    margin_dn = _margin_dn(light_dn)
    return any(light_dn[name] < dark_dn[name] - margin_dn for name in _RISING)


def _margin_dn(dark_dn: Mapping[str, int]) -> float:
    return max(_LEAST_DN, _SPREADS * (dark_dn["99"] - dark_dn["1"]))


class References:
    """Figures of the frames with all LEDs off, and the light of each LED.

    Only the thread that takes the shots may use it; the values it returns are frozen.

    Parameters
    ----------
    camera
        Camera record of the session.
    """

    def __init__(self, camera: CameraRecord) -> None:
        self.range_dn = camera.white_dn - camera.black_level_dn
        self._dark: dict[tuple[Role, float], FrameQuality] = {}
        # Keyed by role, too: the white card reflects more light than the object.
        self._light: dict[tuple[Role, int], SeenLight] = {}

    @classmethod
    def of(cls, session: Session) -> References:
        """Return the references from the frames of an interrupted session."""
        references = cls(session.manifest.camera)
        plan = session.manifest.plan
        planned = {} if plan is None else {shot.key: shot for shot in plan.shots()}
        lines = [frame.line for frame in session.frames if frame.line.key in planned]
        # Unlit frames first: lit ones are compared with them, and they may have been retaken later.
        for line in sorted(lines, key=lambda line: planned[line.key].led is not None):
            references.note(planned[line.key], quality_of(line))
        return references

    def note(self, shot: PlannedShot, quality: FrameQuality) -> bool:
        """Add a frame that counts, and return whether it shows the light of its LED.

        Without an ambient or dark frame of the same exposure this cannot be judged: return True.
        """
        if shot.exposure_us is None:
            return True
        if shot.led is None:
            self._dark[shot.role, shot.exposure_us] = quality
            return True
        if (dark := self.dark(shot)) is None:
            return True
        light = SeenLight.of(
            shot.exposure_us, quality.percentiles_dn, dark.percentiles_dn, self.range_dn
        )
        known = self.light(shot)
        if light is not None and (known is None or light.exposure_us > known.exposure_us):
            self._light[shot.role, shot.led] = light
        return light is not None

    def dark(self, shot: PlannedShot) -> FrameQuality | None:
        """Return the figures of the frame with all LEDs off at the exposure of a shot.

        An ambient frame is preferred to a dark frame, whichever was taken last: lit frames contain
        the ambient light, too.
        """
        if shot.exposure_us is None:
            return None
        ambient = self._dark.get(("ambient", shot.exposure_us))
        return ambient or self._dark.get(("dark", shot.exposure_us))

    def light(self, shot: PlannedShot) -> SeenLight | None:
        """Return the light of the LED of a shot at the longest exposure that showed it."""
        return None if shot.led is None else self._light.get((shot.role, shot.led))


def quality_of(line: FrameLine) -> FrameQuality:
    """Return the figures of a frame from its journal line."""
    return FrameQuality(line.clipped_fraction, line.percentiles_dn, line.sharpness, line.mean_dn)
