"""Images of a recording that do not show the light of their LED on the spheres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calibration._errors import EstimateError
from calibration.radiance.stack import Stack
from calibration.spheres.outline.sphere_image import SphereImage, places
from rig import Notice, figure, listed, pluralize
from rig.arrays import Float64, Intp

# The brightest pixel of a black image, relative to that of the others: rounding leaves a little.
_CODES: dict[str, str] = {"blank": "image-blank", "moved": "image-displaced"}
_BLACK = 0.01
# If a sphere moved on this share of all, camera or table moved.
_ALL_MOVED = 0.5
_LISTED = 3
_AGAIN = "record {} again"
Lights = Intp
"""Indices of lights."""
# Directions with larger standard deviations are no calibration.
_LARGEST_SIGMA_DEG = 10.0
# If more lights are not known, reflections hide so much that other highlights may be wrong, too.
LEAST_SHARE = 0.85
_REMEDY = "cover what shines, or add a short exposure"


@dataclass(frozen=True)
class LostImages:
    """Images of one recording that do not count, by the indices of their lights.

    Parameters
    ----------
    black, white
        Images without any light, and those of which every sample is saturated.
    moved
        For images in which the spheres are elsewhere than in the others: the text about it.
    """

    black: tuple[int, ...] = ()
    white: tuple[int, ...] = ()
    moved: Mapping[int, str] = field(default_factory=dict)

    @property
    def lights(self) -> list[int]:
        """Lights without a usable image, in order."""
        return sorted({*self.black, *self.white, *self.moved})

    def reasons(self, names: Sequence[str]) -> list[tuple[str, Sequence[int], str]]:
        """Return kinds of reasons (see `_CODES`), lights, and texts."""
        reasons: list[tuple[str, Sequence[int], str]] = []
        for which, what in ((self.black, "black"), (self.white, "completely saturated")):
            if which:
                images = "the image is" if len(which) == 1 else "the images are"
                reasons.append(("blank", which, f"{named(names, which)}: {images} {what}"))
        for k, text in self.moved.items():
            reasons.append(("moved", [k], f"{named(names, [k])}: {text}"))
        return reasons

    def check(self, names: Sequence[str]) -> None:
        """Raise `EstimateError` if less than 85 % of the lights are left."""
        lost = self.lights
        if len(names) - len(lost) < LEAST_SHARE * len(names):
            reasons = [text for _, _, text in self.reasons(names)]
            text = listed(reasons, _LISTED, "; ")
            it = _it(lost)
            raise _lost(f"{text}: {_AGAIN.format(it)}, or leave {it} out", names, lost)


def blank_images(stack: Stack) -> LostImages:
    """Return images that are black or completely saturated, unless all are."""
    known = stack.peaks or [np.fmax.reduce(image, axis=None) for image in stack.values]
    peaks = np.array(known, np.float64)
    white = np.isnan(peaks)
    if white.all():
        return LostImages()
    # Merged brackets contain highlights far above 1; matte surfaces next to them are not black.
    black = peaks < _BLACK * min(float(np.median(peaks[~white])), 1.0)
    return LostImages(tuple(np.flatnonzero(black)), tuple(np.flatnonzero(white)))


def moved_images(
    moved: Sequence[Mapping[int, float]], spheres: Sequence[SphereImage]
) -> dict[int, str]:
    """Return the images in which at least half of the spheres are elsewhere, and what to say.

    Parameters
    ----------
    moved
        For each sphere the results of `displaced`.
    spheres
        The spheres.
    """
    texts = {}
    for k in sorted({light for one in moved for light in one}):
        which = [i for i, one in enumerate(moved) if k in one]
        if len(which) >= _ALL_MOVED * len(spheres):
            texts[k] = _moved_text([spheres[i] for i in which], [moved[i][k] for i in which])
    return texts


def moved_alone(
    names: Sequence[str], moved: Mapping[int, float], sphere: SphereImage
) -> list[Notice]:
    """Return notices about images in which one sphere of several is elsewhere."""
    return [
        Notice(
            "sphere-displaced",
            f"{named(names, [k])}: {_moved_text([sphere], [far])}; its highlight there was left "
            f"out: {_AGAIN.format('the image')}",
        )
        for k, far in moved.items()
    ]


def _moved_text(spheres: list[SphereImage], far_px: list[float]) -> str:
    verb = "is" if len(spheres) == 1 else "are"
    far = ", ".join(f"{figure(far)}" for far in far_px)
    return f"{places(spheres)} {verb} {far} px away from where the other images show it" + (
        "" if len(spheres) == 1 else " each"
    )


def lost_lights(
    names: Sequence[str],
    lost: Sequence[LostImages],
    spheres: Sequence[SphereImage],
    recordings: Sequence[str],
) -> tuple[list[int], list[Notice]]:
    """Return the lights that no sphere shows in any recording, and notices about all lost images.

    Parameters
    ----------
    names
        Of all lights.
    lost
        What each recording lost.
    spheres
        The spheres of all recordings, with the highlights of all lights.
    recordings
        A name of each recording; an empty text if there is only one.

    Raises
    ------
    EstimateError
        If less than 85 % of the lights are left.
    """
    seen = np.any([sphere.highlights.candidates.seen for sphere in spheres], axis=0)
    missing = [int(k) for k in np.flatnonzero(~seen)]
    known = {k for one in lost for k in one.lights}
    unknown = [k for k in missing if k not in known]
    on = places(list(spheres))
    if len(recordings) > 1:
        on = f"the spheres of {len(recordings)} recordings"
    if len(names) - len(missing) < LEAST_SHARE * len(names):
        shown = ", ".join(names[k] for k in missing[:4])
        raise _lost(
            f"no highlight under light {shown} ({len(missing)} of "
            f"{pluralize(len(names), 'light')}) on {on}: check that the light was on and that the "
            "outline is correct",
            names,
            missing,
        )
    notices = []
    for one, where in zip(lost, recordings, strict=True):
        for kind, lights, text in one.reasons(names):
            unused = _unused(names, lights, missing)
            again = _AGAIN.format(_it(lights))
            notices.append(Notice(_CODES[kind], f"{text}; {unused}: {again}", where))
    if unknown:
        text = (
            f"left out {named(names, unknown)}: no highlight on {on}: check that the light was on, "
            "and that the spheres show its reflection"
        )
        notices.append(Notice("lights-left-out", text))
    return missing, notices


def _unused(names: Sequence[str], lights: Sequence[int], missing: Sequence[int]) -> str:
    """Return which of the lights of lost images are left out; other recordings show the others."""
    gone = [k for k in lights if k in missing]
    if not gone:
        return "the images do not count" if len(lights) > 1 else "the image does not count"
    which = "the light" + "s" * (len(gone) > 1) if len(gone) == len(lights) else named(names, gone)
    return f"{which} {'are' if len(gone) > 1 else 'is'} left out"


def _it(lights: Sequence[int]) -> str:
    return "them" if len(lights) > 1 else "it"


def _lost(text: str, names: Sequence[str], lights: Sequence[int]) -> EstimateError:
    """Return an error that names the lights that could be left out, if they are the fewer ones."""
    error = EstimateError(text)
    if 2 * len(lights) < len(names):
        error.lights = tuple(names[k] for k in lights)
    return error


def undecided(images: Sequence[SphereImage]) -> Lights:
    """Return the lights that show several possible highlights on a sphere, and one on no sphere."""
    found = np.any([image.highlights.found for image in images], axis=0)
    several = np.any([image.highlights.ambiguous for image in images], axis=0)
    return np.flatnonzero(several & ~found)


def imprecise(covariances: Float64, images: Sequence[SphereImage]) -> Lights:
    """Return the lights whose directions are known to 10 degrees or worse.

    Raises
    ------
    EstimateError
        If this is so for most of them: then it is the outline that is not determined.
    """
    sigma_deg = np.degrees(np.sqrt(np.trace(covariances, axis1=1, axis2=2) / 2))
    if np.isfinite(sigma_deg).any():
        middle = float(np.nanmedian(sigma_deg))
        if middle > _LARGEST_SIGMA_DEG:
            raise EstimateError(
                f"{places(list(images))}: outline and highlights determine the directions only to "
                f"{middle:.0f} degrees: give a mask or a circle, or light the background evenly"
            )
    return np.flatnonzero(sigma_deg > _LARGEST_SIGMA_DEG)


def left_out(
    names: Sequence[str], several: Lights, poor: Lights, images: Sequence[SphereImage]
) -> list[Notice]:
    """Return notices about lights that are left out.

    Parameters
    ----------
    names
        Of all lights.
    several, poor
        Lights with several possible highlights, and with directions that are known to 10 degrees
        or worse.
    images
        The spheres.

    Raises
    ------
    EstimateError
        If less than 85 % of all lights would be left.
    """
    reasons: list[tuple[Lights, str]] = []
    if len(several):
        text = (
            f"{named(names, several)}: several bright spots on {places(list(images))} may be the "
            f"highlight{_where(several, images)}"
        )
        reasons.append((several, text))
    if len(poor):
        text = (
            f"{named(names, poor)}: the highlight on {places(list(images))} determines the "
            f"direction only to {_LARGEST_SIGMA_DEG:.0f} degrees or worse, because a reflection "
            "may hide it"
        )
        reasons.append((poor, text))
    left = len(names) - len(several) - len(poor)
    if reasons and left < LEAST_SHARE * len(names):
        texts = "; ".join(text for _, text in reasons)
        unused = "its image" if len(several) + len(poor) == 1 else "their images"
        raise EstimateError(f"{texts}: {_REMEDY}, or leave out {unused}")
    notices = []
    for which, text in reasons:
        unused = "its image" if len(which) == 1 else "their images"
        text = f"left out {text}; {unused} cannot be used with this calibration: {_REMEDY}"
        notices.append(Notice("lights-left-out", text))
    return notices


def named(names: Sequence[str], which: Sequence[int] | Lights, most: int = 4) -> str:
    """Return a text that names lights, at most so many."""
    return f"light{'s' if len(which) > 1 else ''} {listed([names[k] for k in which], most)}"


def _where(several: Lights, images: Sequence[SphereImage]) -> str:
    """Return the places of the possible highlights of the first light."""
    for image in images:
        if image.highlights.ambiguous[several[0]]:
            first = image.highlights.candidates.pixels[several[0], :2]
            return ", at " + " and ".join(f"({x:.0f}, {y:.0f})" for x, y in first) + " px"
    return ""
