"""Whether normals are those of one surface: their axes, and the surface integrated from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from processing.maps.normal_map import check_normal_rows
from processing.stages.stage import NormalRows
from processing.surface.integrability_test import Axes, Integrability, integrability
from rig import Notice
from rig.arrays import Float32, Float64, Int64

_EDGES = 20_000
# Correct maps have a median of up to 2.3 degrees (simulated reliefs with one pixel for a detail),
# and with noise of 4 degrees per component 2.8. Steps between the leaves of a real plant cause 6.5.
_LIMIT_DEG = 10.0
# Steps in depth bend a smooth surface at a few edges. Its largest angle, and the ratio to the
# median, are 0.2 degree on smooth surfaces and 4 for noise; with steps, at least 5 and 5.
_LARGEST = 0.99
_LARGEST_DEG, _RATIO = 5.0, 5.0


class SomeSteps(NamedTuple):
    """Some steps between neighbouring pixels that the normals demand.

    Parameters
    ----------
    here, there
        Flat numbers of the pixels.
    steps
        The steps.
    """

    here: Int64
    there: Int64
    steps: Float64

    def of(self, u: Float64) -> Float64:
        """Return the steps between the same pixels of a surface."""
        return np.asarray(u.ravel()[self.there] - u.ravel()[self.here], np.float64)


def some_steps(
    right: Float32,
    down: Float32,
    step_right: Float64,
    step_down: Float64,
    every: int | None = None,
) -> SomeSteps:
    """Choose some of the steps along edges.

    Parameters
    ----------
    right, down
        ``(H, W)`` edge weights.
    step_right, step_down
        ``(H, W)`` steps along the edges.
    every
        Which share of the edges is used; the default leaves about 20,000 in each direction.
    """
    found = []
    for weights, steps, offset in ((right, step_right, 1), (down, step_down, right.shape[1])):
        step = every or max(1, -(-np.count_nonzero(weights) // _EDGES))
        # A copy: a view would keep all edges in memory.
        here = np.flatnonzero(weights)[::step].copy()
        inside = here + offset < right.size
        found.append((here[inside], (here + offset)[inside], steps.ravel()[here[inside]]))
    return SomeSteps(*(np.concatenate(each) for each in zip(*found, strict=True)))


class StepAngles(NamedTuple):
    """Angles between given normals and those of a surface, along edges of pixels.

    Parameters
    ----------
    median_deg
        Median, NaN without edges.
    largest_deg
        Which 1 % of the angles exceed.
    """

    median_deg: float
    largest_deg: float

    @classmethod
    def between(cls, slopes: Float64, others: Float64) -> StepAngles:
        """Return the angles between slopes and others at the same places."""
        if not len(slopes):
            return cls(float("nan"), float("nan"))
        angles = np.degrees(np.abs(np.arctan(slopes) - np.arctan(others)))
        return cls(*(float(each) for each in np.quantile(angles, [0.5, _LARGEST])))


_CAUSES: dict[Axes, str] = {
    "right": "",
    "mirrored": "mirrored left to right or top to bottom (green down?)",
    "turned": "turned by 90 degrees",
    "swapped": "with x and y swapped",
}


def axes_notices(normal_map: NormalRows) -> list[Notice]:
    """Return a notice if normals are those of a surface only with other axes.

    The slopes p and q of a surface satisfy dp/dy = dq/dx (see `integrability`). A map whose green
    channel increases downwards contradicts that, and all its relief is inverted along y.

    Parameters
    ----------
    normal_map
        The normals, as they are or a shape or detail component, in orthographic projection.

    Returns
    -------
    list of Notice
        ``normals-mirrored``, or nothing. Turns by 180 degrees, planes and relief with slopes along
        one axis only cannot be judged.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.surface import axes_notices
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> green_up = NormalMap.from_vectors(np.dstack([x + y, x - y, 0 * x + 4]))  # of a saddle
    >>> green_down = NormalMap(green_up.normals * np.float32([1, -1, 1]), green_up.mask)
    >>> [len(axes_notices(green)) for green in (green_up, green_down)]
    [0, 1]
    """
    check_normal_rows("normal_map", normal_map)
    return _axes_notices(integrability(normal_map.normals, normal_map.mask), "")


def consistency_warning(angles: StepAngles, shape: Integrability, *, smooth: bool) -> list[Notice]:
    """Return a warning if normals are not those of one surface, or not of a smooth one."""
    if shape.axes != "right":
        by = f", from which they differ by {angles.median_deg:.1f} degrees (median)"
        return _axes_notices(shape, by)
    if angles.median_deg > _LIMIT_DEG:
        text = (
            "the normals are not those of one surface: the normals of the surface differ from them "
            f"by {angles.median_deg:.1f} degrees (median), so its height is wrong over long "
            "distances: check the map, its mask, and whether the object has steps"
        )
        return [Notice("normals-inconsistent", text)]
    if smooth and angles.largest_deg > max(_LARGEST_DEG, _RATIO * angles.median_deg):
        text = (
            "the normals are not those of a smooth surface: at 1 % of the edges, those of the "
            f"surface differ from them by {angles.largest_deg:.0f} degrees or more (median: "
            f"{angles.median_deg:.1f}). Steps in depth bend a smooth surface: its height is "
            "wrong near them, and over long distances"
        )
        return [Notice("surface-differs", text)]
    return []


def _axes_notices(shape: Integrability, by: str) -> list[Notice]:
    if shape.axes == "right":
        return []
    text = (
        f"the normals are not those of a surface{by} (curl {shape.curl:.2f} of 0 to 1), but "
        f"{_CAUSES[shape.axes]} they are (curl {shape.other_curl:.2f}): check the axes of the map; "
        "a turn by 180 degrees cannot be seen"
    )
    return [Notice("normals-mirrored", text)]
