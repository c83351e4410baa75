"""Errors of transfer results, by three measures.

The plain errors compare a result's normals with the two maps. A mesh method cannot reach 0 in this
measure, because the maps are first integrated to surfaces, and normals are computed from the
resulting surface. The row `FLOOR` is the error of this round trip alone. In the two other measures
every method includes one integration and one computation of normals, and is compared with normals
of the same round trip, so that a perfect transfer has an error of 0:

- from the same surfaces: methods in the normal domain start from the normals of the surfaces that
  the mesh methods receive;
- as surfaces: the results of methods in the normal domain are integrated, and normals are computed
  from the surfaces.

For a mesh method both measures are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

import processing
from benchmarks.paper.peers.surfaces import Surfaces
from rig.arrays import Bool

FLOOR = "round trip without transfer"
PLAIN = ("shape error, deg", "shape SSIM", "detail error, deg", "detail SSIM")
SAME_SURFACES = (
    "shape error from the same surfaces, deg",
    "detail error from the same surfaces, deg",
)
AS_SURFACES = ("shape error as surfaces, deg", "detail error as surfaces, deg")

# Figures by quantity and method.
Judged = dict[str, dict[str, float]]
# A transfer in the normal domain, from source and target to the result.
InNormals = Callable[[processing.NormalMap, processing.NormalMap], processing.NormalMap]


def judge(
    results: Mapping[str, processing.NormalMap],
    source: processing.NormalMap,
    target: processing.NormalMap,
    in_normals: Mapping[str, InNormals],
    *,
    region: Bool | None = None,
    w: int = 5,
) -> Judged:
    """Measure the errors of results with the paper's filter.

    Parameters
    ----------
    results
        Results by method.
    source, target
        The maps, of the same size, from which all results were computed. Pixels without a source
        normal use the target's.
    in_normals
        The methods that work on normals, to be run on other maps.
    region
        ``(H, W)`` bool: the pixels whose errors count. Default: all, with SSIM in the paper's
        protocol.
    w
        Half width of the filter.

    Returns
    -------
    Judged
        `PLAIN`, with `FLOOR` among the methods, `SAME_SURFACES` and `AS_SURFACES`.
    """
    # The mesh methods need a source surface at all pixels of the target.
    around = np.where(source.mask[..., None], source.normals, target.normals)
    filled = processing.NormalMap(np.where(target.mask[..., None], around, 0), target.mask)
    surfaces = Surfaces.of(filled, target)
    read_source, read_target = surfaces.round_trip(filled), surfaces.round_trip(target)
    maps, read = _Meant(source, target, region, w), _Meant(read_source, read_target, region, w)
    judged: Judged = {name: {} for name in (*PLAIN, *SAME_SURFACES, *AS_SURFACES)}

    def add(names: tuple[str, ...], method: str, figures: tuple[float, ...]) -> None:
        for name, figure in zip(names, figures, strict=True):
            judged[name][method] = figure

    for method, result in results.items():
        add(PLAIN, method, maps.compare(result, result))
        again, surface = result, result
        if method in in_normals:
            again = in_normals[method](read_source, read_target)
            surface = surfaces.round_trip(result)
        add(SAME_SURFACES, method, read.errors_deg(again))
        add(AS_SURFACES, method, read.errors_deg(surface))
    add(PLAIN, FLOOR, maps.compare(read_target, read_source))
    return judged


class _Meant:
    """The shape and the detail of a perfect transfer from one map to another."""

    def __init__(
        self,
        source: processing.NormalMap,
        target: processing.NormalMap,
        region: Bool | None,
        w: int,
    ) -> None:
        self._region, self._filter = region, processing.ShapeFilter(order=1, w=w)
        self._shape = processing.separate(target, shape_filter=self._filter).shape
        self._detail = processing.separate(source, shape_filter=self._filter).detail

    def compare(
        self, shape_of: processing.NormalMap, detail_of: processing.NormalMap
    ) -> tuple[float, ...]:
        """Return the `PLAIN` figures of one map's shape and another's detail."""
        figures: list[float] = []
        for part, reference in (
            (processing.separate(shape_of, shape_filter=self._filter).shape, self._shape),
            (processing.separate(detail_of, shape_filter=self._filter).detail, self._detail),
        ):
            protocol: Literal["masked", "paper"] = "paper" if self._region is None else "masked"
            figures.append(processing.angular_error(part, reference, self._region).mae_deg)
            figures.append(processing.ssim(part, reference, self._region, protocol=protocol))
        return tuple(figures)

    def errors_deg(self, result: processing.NormalMap) -> tuple[float, ...]:
        """Return the mean errors of a map's shape and detail."""
        return self.compare(result, result)[::2]
