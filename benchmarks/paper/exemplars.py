"""Exemplars of synthesis: parts of reliefs and normal maps, simulated materials, and drawings."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

import processing
import simulator
from benchmarks.paper.sources import Sources, relief
from rig.arrays import UInt8

SIDE_PX = 256
_PIXEL_MM = 0.3
_RELIEFS = ("151", "160", "188")
_CROP_FROM = 300
# Drawn structures: bricks in running bond, and lines of text.
_BRICK_PX, _JOINT_PX = (64, 26), 4
_RISE_PX = 3.0
_TEXT, _LINE_PX = "Surface Geometry Processing ", 32


def materials(seed: int) -> dict[str, processing.NormalMap]:
    """Return simulated materials by name, seen from above."""
    reach = SIDE_PX * _PIXEL_MM / 2
    return {
        "lizard scales": relief(
            simulator.shapes.LizardScales(400, scale_mm=10, seed=seed), SIDE_PX, reach
        ),
        "textile": relief(simulator.shapes.Textile(400, yarn_mm=6, seed=seed), SIDE_PX, reach),
        "leather": relief(simulator.shapes.CrackedLeather(400, seed=seed), SIDE_PX, reach),
    }


def structured() -> dict[str, processing.NormalMap]:
    """Return drawn exemplars by name, whose structures are larger than patches or ordered."""
    return {"bricks": _drawn(_bricks()), "text": _drawn(_lettering())}


def captured(sources: Sources, *, complete: bool) -> Iterator[tuple[str, processing.NormalMap]]:
    """Yield parts of the reliefs, and the normal maps of owl and plant if complete ones are meant.

    Parameters
    ----------
    sources
        The data; without a folder nothing is returned.
    complete
        Also return complete reliefs and maps.
    """
    if sources.data is None:
        return
    for name in _RELIEFS:
        given = sources.relief(name)
        window = (slice(_CROP_FROM, _CROP_FROM + SIDE_PX),) * 2
        yield (
            f"relief {name}",
            processing.NormalMap(given.normals[window].copy(), given.mask[window].copy()),
        )
        if complete:
            yield f"relief {name}, complete", given
    if complete:
        for name in ("owl", "plant"):
            yield f"{name}, complete", sources.given(name)


def _drawn(raised: UInt8) -> processing.NormalMap:
    """Return the normals of a drawing whose white parts are raised, with round edges."""
    height = cv2.GaussianBlur(raised.astype(np.float32) / 255, (0, 0), 1.5) * _RISE_PX
    down, right = np.gradient(height)
    return processing.NormalMap.from_vectors(np.dstack([-right, down, np.ones_like(height)]))


def _bricks() -> UInt8:
    row, column = np.indices((SIDE_PX, SIDE_PX))
    course = row // _BRICK_PX[1]
    along = (column + course % 2 * _BRICK_PX[0] // 2) % _BRICK_PX[0]
    raised = (row % _BRICK_PX[1] >= _JOINT_PX) & (along >= _JOINT_PX)
    return np.where(raised, np.uint8(255), np.uint8(0))


def _lettering() -> UInt8:
    drawing = np.zeros((SIDE_PX, SIDE_PX), np.uint8)
    for number, base in enumerate(range(_LINE_PX - 8, SIDE_PX + _LINE_PX, _LINE_PX)):
        line = _TEXT[5 * number % len(_TEXT) :] + _TEXT * 2
        cv2.putText(drawing, line, (2, base), cv2.FONT_HERSHEY_SIMPLEX, 0.8, (255,), 2)
    return drawing
