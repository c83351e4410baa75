"""This program at the tasks of the peers, behind the same protocol."""

from __future__ import annotations

from collections.abc import Callable

import acquisition
import processing
from benchmarks.paper.peers.protocol import Peer
from benchmarks.paper.peers.rdn import Low
from processing.superres import SuperResolutionModel

# Side of the patches of small sheets.
PATCH_PX = 24
_PAPER = processing.ShapeFilter(order=1)


def _transfer(target: processing.NormalMap) -> Callable[[processing.NormalMap], object]:
    shape = _PAPER.shape(target)
    return lambda source: processing.combine(
        shape, processing.separate(source, shape_filter=_PAPER).detail
    )


def _surface(
    camera: acquisition.CameraModel | None,
) -> Callable[[processing.NormalMap], processing.HeightMap]:
    return lambda normals: processing.integrate(normals, camera=camera)


def _superres(model: SuperResolutionModel) -> Callable[[Low], processing.NormalMap]:
    return lambda low: (
        processing.super_resolve(low.normals, model.scale, model=model, mask=low.mask).normal_map
    )


def _synthesis(
    exemplar: processing.NormalMap,
) -> Callable[[processing.NormalMap], processing.NormalMap]:
    return lambda shape: processing.synthesize_onto(exemplar, shape, patch=PATCH_PX).detail


def _sheet(
    exemplar: processing.NormalMap,
) -> Callable[[tuple[int, int]], processing.NormalMap]:
    return lambda size: processing.synthesize(exemplar, size, patch=PATCH_PX).detail


_SOURCE = "this program"
TRANSFER = Peer("normals, order 1", _SOURCE, _transfer)
SYNTHESIS = Peer("quilting", _SOURCE, _synthesis)
SHEET = Peer("quilting", _SOURCE, _sheet)
SURFACE = Peer("multigrid", _SOURCE, _surface)
SUPERRES = Peer("details, 8 turned copies", _SOURCE, _superres)
