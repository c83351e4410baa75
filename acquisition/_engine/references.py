"""What earlier frames of a recording tell about later ones."""

from __future__ import annotations

from acquisition._engine.rejection import SeenLight
from acquisition._pixels.quality import FrameQuality
from acquisition._plan.planned_shot import PlannedShot, Role
from acquisition._session.journal import FrameLine
from acquisition._session.manifest import CameraRecord
from acquisition._session.session import Session


class References:
    """Frames with all LEDs off, and what each LED gave.

    Used by the thread that takes the shots alone; what it returns is frozen.

    Parameters
    ----------
    camera
        Of the session.
    """

    def __init__(self, camera: CameraRecord) -> None:
        self.range_dn = camera.white_dn - camera.black_level_dn
        self._dark: dict[float, FrameQuality] = {}
        # A white card under an LED is another thing than the object under it.
        self._light: dict[tuple[Role, int], SeenLight] = {}

    @classmethod
    def of(cls, session: Session) -> References:
        """Return what the frames of a session tell that is gone on with."""
        references = cls(session.manifest.camera)
        plan = session.manifest.plan
        planned = {} if plan is None else {shot.key: shot for shot in plan.shots()}
        lines = [frame.line for frame in session.frames if frame.line.key in planned]
        # As they are taken: ambient frames count before dark ones, and lit ones need them.
        roles = ("dark", "ambient")
        for line in sorted(lines, key=lambda line: (line.role in roles, line.role), reverse=True):
            references.note(planned[line.key], quality_of(line))
        return references

    def note(self, shot: PlannedShot, quality: FrameQuality) -> bool:
        """Take a frame that counts into account, and tell whether it shows its light.

        Ambient light is part of what lit frames have without their LED, so an ambient frame
        replaces a dark one of its exposure. Where there is neither, light cannot be missed.
        """
        if shot.exposure_us is None:
            return True
        if shot.lit_led is None:
            self._dark[shot.exposure_us] = quality
            return True
        if (dark := self.dark(shot)) is None:
            return True
        light = SeenLight.of(
            shot.exposure_us, quality.percentiles_dn, dark.percentiles_dn, self.range_dn
        )
        known = self.light(shot)
        if light is not None and (known is None or light.exposure_us > known.exposure_us):
            self._light[shot.role, shot.lit_led] = light
        return light is not None

    def dark(self, shot: PlannedShot) -> FrameQuality | None:
        """Return the figures of the frame of its exposure with all LEDs off."""
        return None if shot.exposure_us is None else self._dark.get(shot.exposure_us)

    def light(self, shot: PlannedShot) -> SeenLight | None:
        """Return what its LED gave at the longest exposure that showed it."""
        return None if shot.lit_led is None else self._light.get((shot.role, shot.lit_led))


def quality_of(line: FrameLine) -> FrameQuality:
    """Return the figures that a line of the journal has of its frame."""
    return FrameQuality(line.clipped_fraction, line.percentiles_dn, line.sharpness, line.mean_dn)
