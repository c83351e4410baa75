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
        self._dark: dict[tuple[Role, float], FrameQuality] = {}
        # A white card under an LED is another thing than the object under it.
        self._light: dict[tuple[Role, int], SeenLight] = {}

    @classmethod
    def of(cls, session: Session) -> References:
        """Return what the frames of an interrupted session tell."""
        references = cls(session.manifest.camera)
        plan = session.manifest.plan
        planned = {} if plan is None else {shot.key: shot for shot in plan.shots()}
        lines = [frame.line for frame in session.frames if frame.line.key in planned]
        # Lit frames are compared with those of all LEDs off, which may have been taken again later.
        for line in sorted(lines, key=lambda line: planned[line.key].lit_led is not None):
            references.note(planned[line.key], quality_of(line))
        return references

    def note(self, shot: PlannedShot, quality: FrameQuality) -> bool:
        """Take a frame that counts into account, and tell whether it shows its light.

        Where there is neither an ambient nor a dark frame of its exposure, light cannot be missed.
        """
        if shot.exposure_us is None:
            return True
        if shot.lit_led is None:
            self._dark[shot.role, shot.exposure_us] = quality
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
        """Return the figures of the frame of its exposure with all LEDs off.

        An ambient frame comes before a dark one, whichever was taken last: lit frames have the
        ambient light too.
        """
        if shot.exposure_us is None:
            return None
        ambient = self._dark.get(("ambient", shot.exposure_us))
        return ambient or self._dark.get(("dark", shot.exposure_us))

    def light(self, shot: PlannedShot) -> SeenLight | None:
        """Return what its LED gave at the longest exposure that showed it."""
        return None if shot.lit_led is None else self._light.get((shot.role, shot.lit_led))


def quality_of(line: FrameLine) -> FrameQuality:
    """Return the figures that a line of the journal has of its frame."""
    return FrameQuality(line.clipped_fraction, line.percentiles_dn, line.sharpness, line.mean_dn)
