"""Figures of earlier frames of a recording that later ones are compared with."""

from __future__ import annotations

from acquisition._engine.rejection import SeenLight
from acquisition._pixels.frame_quality import FrameQuality
from acquisition._plan.planned_shot import PlannedShot, Role
from acquisition._session.journal import FrameLine
from acquisition._session.manifest import CameraRecord
from acquisition._session.session import Session


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
