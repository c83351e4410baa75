"""Normal maps on which super-resolution is judged, by class of surface."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import processing
import simulator
from benchmarks.paper.exemplars import materials, structured
from benchmarks.paper.sources import Sources, relief
from rig.arrays import Float64

_RELIEFS = ("151", "160", "188")
_CAPTURED = ("owl", "plant")
_SIDE_PX = 512
_QUICK_PX = 256
_DISC_MM = 80.0
_HEAD = "decimated-max.obj"


class Judged(NamedTuple):
    """A map of the high resolution.

    Parameters
    ----------
    kind
        Class of surface.
    name
        Its name.
    truth
        The map.
    """

    kind: str
    name: str
    truth: processing.NormalMap


def judged_maps(sources: Sources, seed: int, *, quick: bool) -> Iterator[Judged]:
    """Yield the maps; without data, only simulated ones.

    Parameters
    ----------
    sources
        The data.
    seed
        Seed of the simulated materials.
    quick
        Use the middle 256 x 256 pixels.
    """
    for kind, name, truth in _complete(sources, seed):
        yield Judged(kind, name, middle(truth, _QUICK_PX) if quick else truth)


def _complete(sources: Sources, seed: int) -> Iterator[tuple[str, str, processing.NormalMap]]:
    if sources.data is not None:
        for name in _RELIEFS:
            yield "reliefs", f"relief {name}", sources.relief(name)
        for name in _CAPTURED:
            yield "captured", name, sources.given(name)
        for name, target in sources.targets().items():
            yield "DiLiGenT", name, target
    yield from (("kinds not trained on", name, one) for name, one in _unseen(seed).items())
    yield from (("kinds trained on", name, one) for name, one in _seen(seed).items())
    yield from (("drawn", name, one) for name, one in structured().items())
    yield from (("smooth", name, one) for name, one in smooth().items())


def _unseen(seed: int) -> dict[str, processing.NormalMap]:
    """Return simulated materials of kinds that no network was trained on, by name."""
    carved = simulator.shapes.WoodCarving(_DISC_MM, seed=seed)
    return {
        "lizard scales": materials(seed)["lizard scales"],
        "wood carving": relief(carved, _SIDE_PX),
    }


def _seen(seed: int) -> dict[str, processing.NormalMap]:
    """Return simulated materials of kinds that are also among the random reliefs, by name."""
    coin = relief(simulator.shapes.Coin(_DISC_MM, seed=seed), _SIDE_PX, _DISC_MM + 1)
    made = materials(seed)
    return {"textile": made["textile"], "leather": made["leather"], "coin": coin}


def smooth() -> dict[str, processing.NormalMap]:
    """Return smooth simulated shapes by name, without noise.

    The limits of the blend were chosen on others: a cap, half of a ball, ripples 145 pixels long,
    and hills 217 pixels wide.
    """
    return {
        "shallow cap": relief(simulator.shapes.SphericalCap(60, 15), _SIDE_PX, 60.5),
        "ripples": relief(simulator.shapes.Ripples(100, wavelength_mm=17), _SIDE_PX),
        "small hills": relief(
            simulator.shapes.BandNoise(100, rms_mm=1, wavelength_mm=25, seed=12), _SIDE_PX
        ),
        "tilted plane": relief(simulator.shapes.Plane(100, slope_x=0.4, slope_y=0.2), _SIDE_PX),
        "saddle": _of_slopes(lambda x, y: (x, -y)),
        "long egg": _of_slopes(lambda x, y: _ratio(-x / 2, y, 1 - x**2 / 2 - y**2)),
        "fading waves": _of_slopes(lambda x, y: (np.sin(9 * x * (1.5 + x)), 0.5 * np.cos(5 * y))),
    }


def _of_slopes(
    slopes: Callable[[Float64, Float64], tuple[Float64, Float64]],
) -> processing.NormalMap:
    """Return the normals of a surface with given slopes in x (right) and y (up), from -1 to 1."""
    along = (np.arange(_SIDE_PX) + 0.5) * 2 / _SIDE_PX - 1
    p, q = slopes(*np.meshgrid(along, -along))
    inside = np.isfinite(p + q)
    return processing.NormalMap.from_vectors(np.dstack([-p, -q, np.ones_like(p)]), inside)


def _ratio(p: Float64, y: Float64, square: Float64) -> tuple[Float64, Float64]:
    """Return the slopes of an ellipsoid, NaN where it is steeper than about 60 degrees."""
    height = np.sqrt(np.where(square > 0.25, square, np.nan))
    return p / height, -y / height


def head(
    sources: Sources, data: Path, scale: int
) -> tuple[processing.NormalMap, processing.NormalMap]:
    """Return the head of Max Planck, projected at low and at high resolution."""
    file = data / "meshes" / _HEAD
    mesh = processing.read_geometry(file)
    sources.files.add(file)
    # The face looks along -Z of the file.
    turn = processing.projection.view_rotation("back")
    side = _SIDE_PX // scale
    low = processing.project(mesh, turn, size=(side, side))
    high = processing.project(
        mesh, turn, size=(scale * side, scale * side), pixel_mm=low.pixel_mm / scale
    )
    return low.normal_map, high.normal_map


def middle(normal_map: processing.NormalMap, side: int) -> processing.NormalMap:
    """Return the middle of a map, at most `side` pixels wide and high."""
    rows, columns = (
        slice(max((length - side) // 2, 0), max((length - side) // 2, 0) + side)
        for length in normal_map.size
    )
    return processing.NormalMap(
        normal_map.normals[rows, columns].copy(), normal_map.mask[rows, columns].copy()
    )
