"""Lights whose directions no highlight determines: they are left out of a calibration by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from calibration._errors import EstimateError
from calibration._spheres.robust import Array
from calibration._spheres.sphere_image import SphereImage, places
from rig import Notice

Lights = npt.NDArray[np.intp]
"""Indices of lights."""

# Directions with larger standard deviations are no calibration.
_LARGEST_SIGMA_DEG = 10.0
# If more lights are not known, reflections hide so much that other highlights may be wrong, too.
LEAST_SHARE = 0.85
_NAMED = 4
_REMEDY = "cover what shines, or add a short exposure"


def undecided(images: Sequence[SphereImage]) -> Lights:
    """Return the lights that show several possible highlights on a sphere, and one on no sphere."""
    found = np.any([image.highlights.found for image in images], axis=0)
    several = np.any([image.highlights.ambiguous for image in images], axis=0)
    return np.flatnonzero(several & ~found)


def imprecise(covariances: Array, images: Sequence[SphereImage]) -> Lights:
    """Return the lights whose directions are known to 10 degrees or worse.

    Raises
    ------
    EstimateError
        If this is so for most of them: then it is the outline that is not determined.
    """
    sigma_deg = _sigma_deg(covariances)
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


def _sigma_deg(covariances: Array) -> Array:
    sigma: Array = np.degrees(np.sqrt(np.trace(covariances, axis1=1, axis2=2) / 2))
    return sigma


def named(names: Sequence[str], which: Sequence[int] | Lights) -> str:
    """Return a text that names lights."""
    more = f" and {len(which) - _NAMED} more" if len(which) > _NAMED else ""
    some = ", ".join(names[k] for k in which[:_NAMED])
    return f"light{'s' if len(which) > 1 else ''} {some}{more}"


def _where(several: Lights, images: Sequence[SphereImage]) -> str:
    """Return the places of the possible highlights of the first light."""
    for image in images:
        if image.highlights.ambiguous[several[0]]:
            first = image.highlights.candidates.pixels[several[0], :2]
            return ", at " + " and ".join(f"({x:.0f}, {y:.0f})" for x, y in first) + " px"
    return ""
