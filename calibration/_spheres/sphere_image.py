"""What the images show of one sphere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration._spheres.ellipse import Ellipse
from calibration._spheres.highlights import Highlights
from calibration._spheres.robust import Array


@dataclass(frozen=True, eq=False)
class SphereImage:
    """What the images show of one sphere.

    Parameters
    ----------
    outline
        The ellipse of its outline.
    points_px
        ``(M, 2)`` outline points.
    coverage
        Share 0..1 of the circumference that was seen.
    highlights
        One per light.
    """

    outline: Ellipse
    points_px: Array
    coverage: float
    highlights: Highlights

    @property
    def rms_px(self) -> float:
        """Scatter of the outline points about the outline, robust."""
        return 1.4826 * float(np.median(np.abs(self.outline.distance_px(self.points_px))))


def missing_highlights_warning(images: list[SphereImage]) -> list[str]:
    """Tell of spheres that show no light, if there are any."""
    dark = [image for image in images if not image.highlights.found.any()]
    if not dark:
        return []
    return [
        f"no highlight under any light on {places(dark)}: it counts for nothing; is it a mirror "
        "sphere, and its outline right?"
    ]


def saturation_warning(images: list[SphereImage]) -> list[str]:
    """Tell of saturated highlights, if there are any."""
    share = np.mean(
        np.concatenate([image.highlights.saturated[image.highlights.found] for image in images])
    )
    if share == 0:
        return []
    return [
        f"{100 * share:.0f} % of the highlights are saturated, their middle may be a degree off: "
        "add a short exposure"
    ]


def places(images: list[SphereImage]) -> str:
    """Name spheres by where they are."""
    where = [f"({i.outline.centre_px[0]:.0f}, {i.outline.centre_px[1]:.0f})" for i in images]
    return ("the sphere at " if len(where) == 1 else "the spheres at ") + ", ".join(where) + " px"
