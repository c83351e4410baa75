"""The figures of `sgp calibrate check`, which `sgp._metrics` assigns to it."""

from __future__ import annotations

from typing import Annotated, NotRequired

# Before Python 3.12, pydantic cannot check a `typing.TypedDict`.
from typing_extensions import TypedDict


class LightDifferenceMetrics(TypedDict):
    """Figures of a light in a comparison of two calibrations."""

    id: Annotated[str, "", "name of the light"]
    angle_deg: Annotated[float, "deg", "angle between its directions from the origin"]
    distance_mm: Annotated[
        float | None, "mm", "distance between its positions; null for directions"
    ]
    intensity_percent: Annotated[
        float | None,
        "%",
        "difference of its intensity after removing `intensity_factor`; null if only one of the "
        "calibrations has intensities",
    ]
    deviations: Annotated[
        float | None,
        "1",
        "difference of position or direction in combined standard deviations; null if they are "
        "not known or zero",
    ]
    intensity_deviations: Annotated[float | None, "1", "the same for the intensity"]
    rest_deg: Annotated[
        float, "deg", "angle that remains after exchanges, a mirror image and the common motion"
    ]
    rest_mm: Annotated[float | None, "mm", "distance that remains after these; null for directions"]
    beyond: Annotated[bool, "", "whether a difference is beyond its limit"]


class MotionMetrics(TypedDict):
    """Figures of a motion that all lights have in common."""

    angle_deg: Annotated[float, "deg", "angle of the rotation about the origin"]
    axis: Annotated[tuple[float, float, float], "1", "unit axis of the rotation, right-handed"]
    shift_mm: Annotated[tuple[float, float, float], "mm", "shift after the rotation"]


class CheckMetrics(TypedDict):
    """Figures of a comparison of two calibrations, or of a calibration and a rig file."""

    lights: Annotated[int, "", "lights that were compared"]
    near: Annotated[bool, "", "whether the lights have positions"]
    beyond: Annotated[int, "", "lights beyond a limit"]
    intensity_factor: Annotated[
        float | None,
        "1",
        "common factor of all intensities, which is no difference; null if only one of the "
        "calibrations has intensities",
    ]
    motion: NotRequired[
        Annotated[MotionMetrics, "", "motion that all lights have in common, if there is one"]
    ]
    mirrored: Annotated[
        str, "", "`x` if left and right are exchanged, `y` for top and bottom, else empty"
    ]
    reversed: Annotated[bool, "", "whether the order is reversed"]
    exchanged: Annotated[list[list[str]], "", "groups of lights at the places of one another"]
    differences: Annotated[list[LightDifferenceMetrics], "", "each light, the worst first"]
