"""Normal maps on which super-resolution is judged, by class of surface."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import processing
import simulator
from sgp._paper.exemplars import materials, structured
from sgp._paper.sources import Sources, bowl, relief

_RELIEFS = ("151", "160", "188")
_CAPTURED = ("owl", "plant")
_SIDE_PX = 512
_QUICK_PX = 256
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
        yield Judged(kind, name, _middle(truth, _QUICK_PX) if quick else truth)


def _complete(sources: Sources, seed: int) -> Iterator[tuple[str, str, processing.NormalMap]]:
    if sources.data is not None:
        for name in _RELIEFS:
            yield "reliefs", f"relief {name}", sources.relief(name)
        for name in _CAPTURED:
            yield "captured", name, sources.given(name)
        for name, target in sources.targets().items():
            yield "DiLiGenT", name, target
    for name, made in materials(seed).items():
        yield "simulated", name, made
    for name, drawn in structured().items():
        yield "simulated", name, drawn
    yield from (("smooth", name, made) for name, made in smooth().items())


def smooth() -> dict[str, processing.NormalMap]:
    """Return smooth simulated shapes by name, without noise."""
    return {
        "cap": bowl(_SIDE_PX**2),
        "half of a ball": relief(simulator.SphericalCap(60, 60), _SIDE_PX, 60.5),
        "long ripples": relief(simulator.Ripples(100, wavelength_mm=40), _SIDE_PX),
        "hills": relief(simulator.BandNoise(100, rms_mm=2, wavelength_mm=60, seed=3), _SIDE_PX),
        "tilted plane": relief(simulator.Plane(100, slope_x=0.4, slope_y=0.2), _SIDE_PX),
    }


def head(sources: Sources, scale: int) -> tuple[processing.NormalMap, processing.NormalMap] | None:
    """Return the head of Max Planck, projected at low and at high resolution; None without data."""
    if sources.data is None:
        return None
    file = sources.data / "meshes" / _HEAD
    mesh = processing.read_geometry(file)
    sources.files.add(file)
    # The face looks along -Z of the file.
    turn = processing.view_rotation("back")
    side = _SIDE_PX // scale
    low = processing.project(mesh, turn, size=(side, side))
    high = processing.project(
        mesh, turn, size=(scale * side, scale * side), pixel_mm=low.pixel_mm / scale
    )
    return low.normal_map, high.normal_map


def _middle(normal_map: processing.NormalMap, side: int) -> processing.NormalMap:
    rows, columns = (
        slice(max((length - side) // 2, 0), max((length - side) // 2, 0) + side)
        for length in normal_map.size
    )
    return processing.NormalMap(
        normal_map.normals[rows, columns].copy(), normal_map.mask[rows, columns].copy()
    )
